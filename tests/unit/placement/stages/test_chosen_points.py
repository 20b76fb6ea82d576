from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Targets
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.records.tables import read_table, write_table
from roadsight.stages.placement.measure_data import MeasuringFiles, points_by_height
from roadsight.stages.placement.shared.detection_inputs import read_shaped_targets
from tests.unit.placement.stages.test_pose_stages import detect, road  # noqa: F401 (a fixture)


@pytest.mark.parametrize("box", [None, ("0.5", "0.5", "1.7")])
def test_sensors_in_poses_add_up_to_what_detection_measured(road, box):  # noqa: F811
    folder, _ = road
    options = ["--box", *box] if box else []
    place = str(folder / ("headed" if box else "targets"))
    if box:
        write_table(place, read_table(folder / "targets").assign(heading_rad=0.3))
    kinds = {"eye": "pixels", "brush": "points", "ring": "points", "ear": None}
    seen = read_detections([detect(folder, name, *options, "--targets", place) for name in kinds])
    rows = seen[["sensor", "candidate"]].drop_duplicates().astype(str)
    chosen = rows.groupby("sensor").head(2).reset_index(drop=True)
    given = MeasuringFiles(
        targets=Path(place), radius_m=Targets().radius_m, height_m=Targets().height_m,
        box=tuple(map(float, box)) if box else None, sensors=folder / "sensors.yaml",
        depth=[folder / "depth"], candidates=[folder / "candidates"], azimuth_stride=1,
    )  # fmt: skip
    targets, feet, shape = read_shaped_targets(given)
    for name, unit in kinds.items():
        part = chosen[chosen["sensor"] == name]
        found = points_by_height(given, part, feet, shape)
        assert list(found) == ([unit] if unit else [])
        if unit is None:
            continue
        mine = seen[seen["candidate"].astype(str).isin(part["candidate"])]
        mine = mine[mine["sensor"].astype(str) == name]
        # Two sensors may see a target, of which one too weakly to count.
        told = mine.groupby(mine["target"].astype(str))["hits"].sum()
        total = pd.Series(found[unit].sum(axis=1), targets["target"].astype(str))
        assert (total[told.index] > told - len(part)).all()
        both = mine.groupby(mine["target"].astype(str)).size() == len(part)
        alike = told[both[both].index]
        np.testing.assert_allclose(total[alike.index], alike, atol=len(part))
    with pytest.raises(InputError, match="missing"):
        points_by_height(given, pd.DataFrame({"sensor": ["ring"], "candidate": ["a"]}), feet, shape)
