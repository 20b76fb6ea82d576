import json

import geopandas as gpd
import numpy as np
import pytest
import shapely
import yaml

from roadsight.base.errors import InputError
from roadsight.io.vector.vectors import write_geojson
from roadsight.stages.placement import solve_cover
from roadsight.studio.layout import Layouts
from roadsight.studio.project import Project
from tests.helpers.report_site import ReportSite
from tests.helpers.small_workflow import without_sites

SETTINGS = {"shards": 1, "coverage": {"shards": 1, "uncoverable": "exclude"}}
SENSOR = "OS1-32"
MINE = {"title": "Mine", "sensors": [SENSOR]}


class Street:
    """A street with a plan of its own, ``mine``, that is solved by the workflow's stage."""

    def __init__(self, root):
        self.root, self.made = root, ReportSite(root / "results", "tiny", hidden=0.1)
        self.frame = self.made.frame

    def write(self, mounting, placement, options):
        """The site file, with maps named in it."""
        content = {"site": "tiny", "jobs": ["placement"], "clouds": ["x.laz"]}
        content["placement"] = {**placement, "own_plans": {"mine": MINE | options}}
        content["settings"] = {**SETTINGS, "mounting": mounting}
        (self.root / "config/sites/tiny.yaml").write_text(yaml.safe_dump(content))

    def polygons(self, name, *boxes):
        shapes = [shapely.box(*box) for box in boxes]
        table = gpd.GeoDataFrame({"name": [f"a{k}" for k in range(len(boxes))]}, geometry=shapes)
        write_geojson(self.root / "config/sites" / name, table, self.frame)

    def points(self, name, **columns):
        xy = np.column_stack([columns.pop("x"), columns.pop("y"), np.zeros(len(columns["id"]))])
        table = gpd.GeoDataFrame(columns, geometry=gpd.points_from_xy(xy[:, 0], xy[:, 1]))
        write_geojson(self.root / "config/sites" / name, table, self.frame)

    def solve(self, layout_arguments):
        """Solve the plan with the arguments that the studio reads its choices by."""
        path = self.made.path
        asked, mine = layout_arguments, "placement/mine"
        write = {part: str(path(mine, f"{part}.json")) for part in ("solution", "timing")}
        covered = json.loads(path("placement/round-1/coverage.json").read_text())
        covered["plans"]["mine"] = covered["plans"]["os-32"]
        path("placement/round-1/coverage.json").write_text(json.dumps(covered))
        named = {
            "site": "tiny", "plan": "mine", "coverage": path("placement/round-1/coverage.json"),
            "targets": path("placement/targets.parquet"), "frame": path("scene/frame.json"),
            "layers": path(mine, "solution.gpkg"), "uncoverable": "exclude", **write, **asked,
        }  # fmt: skip
        rounds = [path(f"placement/round-{n}/candidates.parquet") for n in (0, 1)]
        shards = [path(f"placement/round-{n}/detection/{SENSOR}/0.parquet") for n in (0, 1)]
        lists = {"candidates": rounds, "detections": shards, "sensors": [f"{SENSOR}=1.0"]}
        words = [part for key, value in named.items() for part in (f"--{key}", str(value))]
        words += [part for key, values in lists.items() for part in (f"--{key}", *map(str, values))]
        assert solve_cover.main(words) == 0
        return json.loads(path(mine, "solution.json").read_text())


@pytest.fixture
def street(tmp_path, monkeypatch):
    monkeypatch.chdir(without_sites(tmp_path))
    return Street(tmp_path)


CASES = {
    "masts": ({"mast_cost": 5.0, "mast_cost_per_m": 0.5}, {}, {}),
    "zones": ({}, {"zones": "zones.geojson"}, {}),
    "cables": ({"cable_cost_per_m": 0.2}, {"cabinets": "cabinets.geojson"}, {}),
    "forbidden": ({}, {}, {"forbidden": {"file": "zones.geojson"}}),
    "poles": ({}, {}, {"poles": {"file": "poles.geojson", "new_cost": 3.0}}),
    "spacing": ({}, {}, {"spacing_m": 9.0}),
}


@pytest.mark.parametrize("case", CASES)
def test_costs_and_places_are_the_solvers(street, case):
    mounting, placement, options = CASES[case]
    zone = (-100.0, -100.0, 40.0, 21.0)  # one side of the first 25 m
    street.polygons("zones.geojson", zone)
    street.points("cabinets.geojson", x=[10.0], y=[10.0], id=["c"])
    street.points("poles.geojson", x=[15.0, 35.0], y=[27.0, 27.0], id=["p", "q"], cost=[0.0, 1.0])
    street.write(mounting, placement, options)
    site = Project(street.root).site("tiny")
    plan, rules = site.resolved.plans["mine"], site.resolved.settings.mounting
    asked = {"mounting": rules.model_dump_json(), "options": plan.options()}
    asked |= {name: f"config/sites/{file}" for name, file in placement.items()}
    asked |= {name: f for name in ("forbidden", "poles") if (f := plan.file_of(name))}
    solution = street.solve(asked)
    layout = Layouts(Project(street.root)).of("tiny", "mine")
    counted = layout.coverage(layout.chosen)
    assert counted["cost"] == pytest.approx(solution["objective"], abs=1e-6)
    assert counted["covered"] == solution["covered_targets"]
    # What is proposed may stand there: greedily to the end, and none of it is barred.
    rows, barred = [], shapely.box(*zone)
    while (best := layout.coverage(np.array(rows, np.int64))["next"]) is not None:
        rows.append(best)
    places = layout.places.iloc[rows][["x", "y"]].to_numpy()
    assert layout.coverage(np.array(rows))["covered"] == solution["covered_targets"]
    assert layout.coverage(np.array(rows))["cost"] >= solution["objective"] - 1e-6
    if case in ("zones", "forbidden"):
        assert not shapely.intersects_xy(barred, *places.T).any()
        assert not shapely.intersects_xy(barred, *layout.places[["x", "y"]].to_numpy().T).any()
    if case == "spacing":
        near = np.linalg.norm(places[:, None] - places[None], axis=2) < 9.0 - 1e-6
        assert near.sum() == len(rows)
        both = np.argsort(np.linalg.norm(layout.places[["x", "y"]] - places[0], axis=1))
        other = next(row for row in both if layout.choices["position"][row] != rows[0])
        with pytest.raises(InputError, match="spacing_m"):
            layout.coverage(np.array([rows[0], other]))


def test_a_zone_that_is_drawn_later_makes_another_version(street):
    street.polygons("zones.geojson", (0.0, 0.0, 1.0, 1.0))
    street.write({}, {"zones": "zones.geojson"}, {})
    layouts = Layouts(Project(street.root))
    street.solve({"zones": "config/sites/zones.geojson"})
    first = layouts.of("tiny", "mine")
    assert layouts.of("tiny", "mine") is first
    street.polygons("zones.geojson", (-500.0, -500.0, 500.0, 500.0))
    with pytest.raises(InputError, match="no candidate may carry a sensor"):
        layouts.of("tiny", "mine")
    x, y = first.places[["x", "y"]].to_numpy()[first.chosen[0]]
    street.polygons("zones.geojson", (x - 1, y - 1, x + 1, y + 1))
    with pytest.raises(InputError, match="zones or rules of mounting have changed"):
        layouts.of("tiny", "mine")
    street.write({"mast_cost": 2.0}, {}, {})
    again = layouts.of("tiny", "mine")
    assert again.version != first.version
    assert again.coverage(again.chosen)["cost"] == 3 * len(again.chosen)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"availability": 0.9}, "90 % of the time"),
        ({"robust": "tolerance"}, "with tolerance"),
        ({"spacing_m": 1.0}, None),
    ],
)
def test_what_is_not_counted_is_said(street, options, told):
    street.write({}, {}, {})
    street.solve({})
    street.write({}, {}, options)
    notes = Layouts(Project(street.root)).of("tiny", "mine").about()["notes"]
    assert len(notes) == (told is not None)
    assert all(told in note and "not counted here" in note for note in notes)
