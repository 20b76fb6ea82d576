"""Change this -> so many steps, and so many depth maps: a small change is a small run."""

import re

import geopandas as gpd
import pytest
from shapely import Point

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import write_geojson

SITE = "config/sites/tiny.yaml"


def write_feature(checkout, name, shape, about):
    """A file beside the site file, from a shape in local metres."""
    frame = Frame.from_dict(read_json(checkout.folder / "results/tiny/scene/frame.json"))
    table = gpd.GeoDataFrame({key: [value] for key, value in about.items()}, geometry=[shape])
    write_geojson(checkout.folder / "config/sites" / name, table, frame)


def candidates(checkout):
    return read_table(checkout.folder / "results/tiny/placement/round-0/candidates.parquet")


def place(checkout, row):
    """Candidate of round 0."""
    return Point(*candidates(checkout)[["x", "y"]].iloc[row])


def beside_edges(checkout, line):
    checkout.edit(SITE, "  edges: sample\n", f"  edges: sample\n  {line}\n")


def after_detection(checkout):
    return {"check_coverage"} | checkout.after("solve_cover")


class TestNothingIsRendered:
    """Steps that a change makes stale: the last coverage check, the covers, and what follows."""

    @pytest.mark.parametrize("change", ["zone", "mounting", "cabinets"])
    def test_where_candidates_only_become_dearer_or_fewer(self, copy_of_finished, change):
        if change == "zone":
            zone = place(copy_of_finished, 4).buffer(3.0)
            write_feature(copy_of_finished, "zones.geojson", zone, {"name": "z"})
            beside_edges(copy_of_finished, "zones: zones.geojson")
        elif change == "cabinets":
            point = place(copy_of_finished, 4)
            write_feature(copy_of_finished, "cabinets.geojson", point, {"name": "k1"})
            beside_edges(copy_of_finished, "cabinets: cabinets.geojson")
        else:
            copy_of_finished.edit(
                SITE, "  shards: 2\n", "  shards: 2\n  mounting: {mast_cost: 1}\n"
            )
        listed = {"match_inputs"} if change != "mounting" else set()
        assert copy_of_finished.stale_rules() == after_detection(copy_of_finished) | listed

    def test_where_a_price_changes(self, copy_of_finished):
        before = "  OS1-32: {like: OS1-64,"
        copy_of_finished.edit("config/sensors.yaml", before, f"{before} cost: 2,")
        assert copy_of_finished.stale_rules() == copy_of_finished.after("solve_cover")


def taken_over(checkout):
    """Maps made anew, and maps of an earlier run, over all logs of round 0."""
    found = [0, 0]
    for log in checkout.folder.glob("logs/tiny/round-0/*/*/render_depth_maps.log"):
        old, every = re.findall(r"(\d+) of (\d+) maps are those", log.read_text())[-1]
        found[0] += int(every) - int(old)
        found[1] += int(old)
    return found


def test_a_pole_more_renders_its_own_candidates_and_no_others(copy_of_finished):
    before = candidates(copy_of_finished)
    near = place(copy_of_finished, int((before["edge"] == "left").to_numpy().argmax()))
    pole = Point(near.x + 1.0, near.y + 1.5)
    write_feature(copy_of_finished, "mounts.geojson", pole, {"name": "p1", "height_m": 9.0})
    beside_edges(copy_of_finished, "mounts: mounts.geojson")
    result = copy_of_finished.snakemake("--cores", "2", "--until", "check_coverage")
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    more = len(candidates(copy_of_finished)) - len(before)
    assert 0 < more < 8
    # For each of the two sensors.
    assert taken_over(copy_of_finished) == [2 * more, 2 * len(before)]


def test_a_zone_takes_its_candidates_from_every_plan(copy_of_finished):
    folder = copy_of_finished.folder / "results/tiny/placement/os-64"
    chosen = read_json(folder / "solution.json")["sensors"][0]
    zone = Point(chosen["x"], chosen["y"]).buffer(3.0)
    write_feature(copy_of_finished, "zones.geojson", zone, {"name": "z"})
    beside_edges(copy_of_finished, "zones: zones.geojson")
    target = "results/tiny/placement/os-64/solution.json"
    result = copy_of_finished.snakemake("--cores", "2", target)
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    for sensor in read_json(folder / "solution.json")["sensors"]:
        assert not zone.contains(Point(sensor["x"], sensor["y"]))
