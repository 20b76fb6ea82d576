"""Two small sites, run once for all levels and verbs."""

import pytest

from tests.options.registry import Finished
from tests.properties.placement_job import PlacementJob, make_street
from tests.properties.poles_job import PolesJob, make_lane


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> Finished:
    folder = tmp_path_factory.mktemp("options")
    lane, shown = make_lane(images=8)
    street = PlacementJob(folder / "street").run(make_street())
    return Finished(street, PolesJob(folder / "lane", shown).run(lane), lane)
