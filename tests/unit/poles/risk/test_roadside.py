import numpy as np
import pandas as pd
import pytest

from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.hazard import HAZARD_COLUMNS, ROADSIDE_COLUMNS, rate_roadside
from roadsight.poles.risk.inventory import check_inventory
from roadsight.poles.risk.roads import RouteTracks, roads_of
from roadsight.poles.risk.roadside import Surroundings, section_table
from roadsight.poles.risk.roadside_rating import SOURCES
from roadsight.poles.risk.shielding import barriers_along
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives, shots
from tests.helpers.rated_poles import rate_poles
from tests.helpers.rural_sections import exact_height, ground_points, open_stations, true_hinges

RULES = Hazard()


class Scene:
    """A generated road with what the stage would read of it."""

    def __init__(self, seed):
        self.site = site = build_rural(seed, 300.0, detail=0.01)
        rng = np.random.default_rng(seed)
        places = [s for drive in random_drives(seed) for s in shots(site, drive, seed)]
        rows = [(s.route, s.sequence, *s.gps_xy_m) for s in places]
        self.tracks = RouteTracks(pd.DataFrame(rows, columns=["route", "sequence", "x", "y"]))
        half, along = site.ground.section.pavement_m, np.arange(-20, 320, 0.25)
        edges = np.concatenate([site.line.plan(along, side * half) for side in (1, -1)])
        self.edges = edges + rng.normal(0, 0.03, edges.shape)
        self.roads = roads_of(self.tracks, self.edges)
        self.points = ground_points(site, rng, (0.0, 300.0), half_m=20.0, per_m2=15)
        posts = [p for p in site.poles if 5 < p.station_m < 295 and abs(p.offset_m) < 13]
        self.geometry = {}  # of the roads, which all ratings share
        self.offset = np.array([p.offset_m for p in posts])
        self.station = np.array([p.station_m for p in posts])
        self.poles = pd.DataFrame([p.xyz_m for p in posts], columns=["x", "y", "z"]).assign(
            sigma_major_m=0.3
        )

    def rated(self, **more):
        height = exact_height(self.site)
        known = Surroundings(self.roads, height, self.points, _geometry=self.geometry, **more)
        return rate_roadside(self.poles, self.edges, known, RULES)


@pytest.fixture(scope="module", params=[1, 3])
def scene(request):
    return Scene(request.param)


def test_a_ditch_no_longer_disappears(scene):
    table = scene.rated().table
    assert list(table.columns) == [*HAZARD_COLUMNS, *ROADSIDE_COLUMNS]
    _, slopes = true_hinges(scene.site)
    clear = np.zeros(len(table), bool)
    for side in (-1, 1):
        near = np.abs(scene.station[:, None] - open_stations(scene.site, side, 1.0)).min(axis=1) < 1
        clear |= near & (np.sign(scene.offset) == side)
    own = table[clear]
    assert clear.sum() >= 5
    assert own["foreslope_rise_over_run"].to_numpy() == pytest.approx(slopes[1], abs=0.02)
    assert own["foreslope_ratio"].isin(["1V:2.2H", "1V:2.3H", "1V:2.4H"]).all()
    beyond = np.abs(scene.offset[clear]) > scene.site.ground.section.shoulder_m + 0.5
    assert (own["slope_class"][beyond] == "critical").all()
    assert own["ditch_depth_m"].to_numpy() == pytest.approx(0.65 + 0.05 * 1.3, abs=0.06)
    assert own["ditch_bottom_width_m"].to_numpy() == pytest.approx(0.7, abs=0.2)
    assert "steeper than 1V:3H [RDG 3.3]" in own["reasons"][beyond].iloc[0]


def test_sides_stations_and_ranks(scene):
    table = scene.rated().table
    assert (table["side"] == -np.sign(scene.offset)).all()
    gap = table["station_m"] - scene.station
    assert np.ptp(gap) < 0.3
    assert sorted(table["rank"]) == list(range(1, len(table) + 1))
    high = table["rating"] == "high"
    assert table["rank"][high].max() == high.sum()
    marks = set("".join(table["reasons"]).split("[")[1:])
    assert {mark.split("]")[0] for mark in marks} <= set(SOURCES)


def test_inventories_decide_by_station_and_lack_gives_ranges(scene):
    rows = [("sr1427", 0, 150, 60, 500, 2), ("sr1427", 150, 400, np.nan, 8000, 2)]
    names = ["route", "from_m", "to_m", "speed_kmh", "aadt", "lanes"]
    inventory = check_inventory(pd.DataFrame(rows, columns=names), "i.csv")
    table = scene.rated(inventory=inventory).table
    first = table["station_m"] < 150
    assert (table["design_speed_greatest_kmh"][first] == 60).all()
    bare = first & ~table["reasons"].str.contains("non-recoverable slope are added")
    assert bare.sum() > 5
    assert (table["clear_zone_greatest_m"][bare] <= 3.0 * 1.5).all()
    last = table[~first]
    assert (last["design_speed_least_kmh"] == 60).all()
    assert (last["design_speed_greatest_kmh"] == 110).all()
    assert (last["clear_zone_greatest_m"] > last["clear_zone_least_m"] + 2).all()
    doubtful = last[
        (last["offset_m"] > last["clear_zone_least_m"]) & (last["offset_m"] <= last["clear_zone_m"])
    ]
    assert (doubtful["rating"] == "medium").all()
    assert doubtful["reasons"].str.contains("perhaps inside").all()


def test_barriers_shield_and_lower_the_rating(scene):
    at = np.arange(-10.0, 311)
    lines = [scene.site.line.plan(at, side * 4.3) for side in (1, -1)]
    barriers, lost = barriers_along(lines, ["left", "right"], scene.roads)
    assert lost == []
    bare, shielded = scene.rated().table, scene.rated(barriers=barriers).table
    middle = (scene.station > 100) & (scene.station < 200) & (np.abs(scene.offset) > 5.8)
    assert (shielded["shielded"][middle] == "full").all()
    assert (shielded["rating"][middle] == "low").all()
    assert (bare["rating"] != "low").any()
    assert shielded["barrier_offset_m"][middle].to_numpy() == pytest.approx(
        4.3 - scene.site.ground.section.pavement_m, abs=0.1
    )
    assert (shielded["hazard_rating_1_to_7"][middle] <= 5).all()
    near_end = scene.station < 20
    assert (shielded["shielded"][near_end] != "full").all()


def test_tables_of_sections(scene):
    known = Surroundings(scene.roads, None, scene.points)
    nobody, nowhere = scene.roads.locate(np.empty((0, 2))), np.empty((0, 2))
    table = section_table(known, [], nobody, nowhere, nowhere, [], 25.0)
    assert set(table["side"]) == {-1, 1}
    assert (table["station_m"] % 25 == 0).all()
    first = table[table["section"] == table["section"].iloc[0]]
    assert first["end_m"].iloc[-1] == pytest.approx(12, abs=0.3)
    assert set(first["kind"]) >= {"shoulder", "foreslope"}


def test_rows_of_other_indexes_and_unknown_surroundings(scene):
    poles = scene.poles.iloc[3:6]
    table = rate_poles(poles, scene.edges, scene.tracks, None, RULES)
    assert table.index.tolist() == poles.index.tolist()
    assert (table["reasons"].str.contains("ground before it is unknown")).all()
    far = poles.assign(x=poles["x"] + 5000)
    lost = rate_poles(far, scene.edges, scene.tracks, None, RULES)
    assert (lost["rating"] == "unknown").all()
    assert (lost["hazard_rating_1_to_7"] == 0).all()
    assert (lost["reasons"] == "no road edge is near").all()
