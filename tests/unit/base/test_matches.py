import logging

import pytest

from roadsight.base.doubts import FEW, tell_matches, tell_named
from roadsight.base.errors import InputError

LOG = logging.getLogger("roadsight.test")


@pytest.mark.parametrize("matched, told", [(10, False), (8, False), (7, True), (1, True)])
def test_few_matches_are_a_doubt(matched, told, caplog):
    doubts = tell_matches(LOG, "zones lie at the site", matched, 10, "z.gpkg", "look")
    assert len(doubts) == told
    if told:
        assert (doubts[0].severity, doubts[0].limit) == ("doubt", FEW)
        assert doubts[0].measured == matched / 10
        assert f"only {matched} of 10 zones lie at the site: z.gpkg; look" in caplog.text


def test_none_is_refused_and_nothing_is_nothing():
    with pytest.raises(InputError, match="none of 3 zones"):
        tell_matches(LOG, "zones lie at the site", 0, 3, "z.gpkg")
    assert tell_matches(LOG, "zones lie at the site", 0, 0, "z.gpkg") == []


def test_names_of_more_than_what_is_used():
    known = {f"a{n}.jpg" for n in range(0, 50, 5)}
    assert tell_named(LOG, "cameras", {f"a{n}.jpg" for n in range(50)}, known, "c.csv") == []
    few = tell_named(LOG, "corrections", {"a5.jpg", "b1.jpg"}, known, "c.csv")
    assert "such as b1.jpg" in few[0].message
    with pytest.raises(InputError, match=r"it names b1\.jpg, the videolog a0\.jpg"):
        tell_named(LOG, "corrections", {"b1.jpg"}, known, "c.csv")
