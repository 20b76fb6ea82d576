import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, box

from roadsight.base.errors import InputError
from roadsight.scene.pavement.choice import FINEST_M, MOST_CELLS, choose_method
from roadsight.scene.pavement.pavement_doubts import PavementFacts, pavement_doubts
from roadsight.scene.pavement.road_surface import KnownRoad, RoadSettings, find_road, road_points
from roadsight.scene.pavement.scan_levels import count_scans
from tests.unit.scene.pavement.test_road_surface import f1, street

WIDE_M = 1.1 * MOST_CELLS**0.5 * FINEST_M


def profile(number=10, blind_share=1.0, side_m=100.0):
    scans = {"number": number, "blind_share": blind_share}
    return {"extent_m": [side_m, side_m, 10.0], "scans": scans}


@pytest.mark.parametrize(
    ("stated", "seeded", "about", "method", "why"),
    [
        ("auto", False, profile(), "surface", "blind disc"),
        ("auto", False, profile(number=1), "published", "does not tell scans apart"),
        ("auto", False, profile(blind_share=0.2), "published", "few scans show"),
        ("auto", False, profile(side_m=WIDE_M), "published", "too wide"),
        ("auto", True, profile(number=1), "surface", "seeds"),
        ("surface", False, profile(number=1), "surface", "so stated"),
        ("published", True, profile(), "published", "so stated"),
        ("auto", False, {"extent_m": [9, 9, 1]}, "published", "does not tell"),
    ],
)
def test_the_way_follows_what_the_cloud_tells(stated, seeded, about, method, why):
    choice = choose_method(stated, seeded, about)
    assert choice.method == method and why in choice.why
    told = choice.told()
    assert told.severity == "note" and told.code == "pavement_method" and why in told.message


@pytest.mark.parametrize(("stated", "seeded"), [("surface", False), ("auto", True)])
def test_a_site_too_wide_for_a_stated_surface_is_refused(stated, seeded):
    with pytest.raises(InputError, match="too wide"):
        choose_method(stated, seeded, profile(side_m=WIDE_M))


def test_scans_of_a_vehicle_are_counted_part_by_part(rng):
    xyz, _, scan, _ = street(rng)
    west = xyz[:, 0] < 25
    whole = count_scans(lambda: [(xyz, scan)])
    assert whole["number"] == 6 and whole["blind_share"] > 0.5
    parts = count_scans(lambda: [(xyz[west], scan[west]), (xyz[~west], scan[~west])])
    assert parts == whole


def test_one_scan_and_strips_tell_nothing(rng):
    xyz = np.column_stack([rng.uniform(0, 40, (40_000, 2)), np.zeros(40_000)])
    assert count_scans(lambda: [(xyz, np.zeros(len(xyz), np.int64))])["number"] == 1
    strips = rng.integers(0, 2, len(xyz))
    assert count_scans(lambda: [(xyz, strips)]) == {"number": 2, "blind_share": 0.0}


class TestKnownRoad:
    def test_seeds_choose_the_road(self, rng):
        xyz, tone, _, road = street(rng)
        surface = find_road(xyz, tone, None, KnownRoad(seeds_xy=np.array([[25.0, 0.0]])))
        assert surface.seeded_by == "seeds" and surface.parts == 1
        assert f1(road_points(surface, xyz, RoadSettings()), road) > 0.93

    def test_a_seed_off_the_cloud_is_refused_by_its_number(self, rng):
        xyz, tone, _, _ = street(rng)
        seeds = np.array([[25.0, 0.0], [900.0, 0.0]])
        with pytest.raises(InputError, match="seed 2 of 2 lies where no ground was measured"):
            find_road(xyz, tone, None, KnownRoad(seeds_xy=seeds))

    def test_road_points_of_the_file_are_seeds(self, rng):
        xyz, tone, _, road = street(rng)
        said = road & (np.abs(xyz[:, 0] - 25) < 8)
        surface = find_road(xyz, tone, None, KnownRoad(road=said))
        assert surface.seeded_by == "classes"
        assert f1(road_points(surface, xyz, RoadSettings()), road) > 0.93

    def test_the_road_ends_at_digitised_edges_and_water(self, rng):
        xyz, tone, _, road = street(rng, kerb_m=0.0)
        tone[:] = 25.0
        seeds = np.array([[25.0, 0.0]])
        edges = [shapely.LineString([(-5, y), (60, y)]) for y in (-4.0, 4.0)]
        free = find_road(xyz, tone, None, KnownRoad(seeds_xy=seeds))
        ended = find_road(xyz, tone, None, KnownRoad(seeds_xy=seeds, edges=edges))
        off = [float((road_points(s, xyz, RoadSettings()) & ~road).mean()) for s in (free, ended)]
        assert off[0] > 0.05 and off[1] < 0.01
        canal = xyz[np.abs(xyz[:, 1] - 6.0) < 1.0, :2]
        dry = np.abs(xyz[:, 1] - 6.0) >= 1.0
        known = KnownRoad(seeds_xy=seeds, water_xy=canal)
        beside = find_road(xyz[dry], tone[dry], None, known)
        cells = beside.road | beside.bridged
        column, row = beside.grid.indices(canal[:, 0], canal[:, 1])
        assert not cells[row, column].any()


def facts_of(xyz, classes=None, outline=None):
    facts = PavementFacts()
    on = shapely.contains_xy(outline, xyz[:, 0], xyz[:, 1])
    facts.add_points(xyz, classes, np.ones(len(xyz), bool), on)
    return facts


def codes(doubts, severity="doubt"):
    return {doubt.code for doubt in doubts if doubt.severity == severity}


@pytest.fixture
def plain(rng):
    """40 points a square metre over a corridor of 200 m x 20 m."""
    return np.column_stack([*rng.uniform(0, (200, 20), (160_000, 2)).T, np.zeros(160_000)])


ROAD = MultiPolygon([box(0, 6, 200, 14)])


class TestDoubts:
    def test_a_sound_pavement_has_notes_alone(self, plain):
        doubts = pavement_doubts(ROAD, "surface", facts_of(plain, outline=ROAD), 0.005, 0.2)
        assert codes(doubts) == set()
        assert all(doubt.measured is not None for doubt in doubts)
        assert {"pavement_parts", "pavement_reach", "pavement_density"} <= codes(doubts, "note")

    @pytest.mark.parametrize(
        ("cls", "share", "code"),
        [(9, 0.3, "pavement_water"), (5, 1.0, "pavement_classes"), (11, 1.0, None)],
    )
    def test_what_the_file_calls_it(self, plain, cls, share, code):
        classes = np.where(np.arange(len(plain)) < share * len(plain), cls, 2).astype(np.uint8)
        doubts = pavement_doubts(ROAD, "published", facts_of(plain, classes, ROAD), 0.005, 0.2)
        assert codes(doubts) - {"pavement_own_road"} == ({code} if code else set())

    def test_a_sea_is_refused_unless_the_user_drew_it(self, plain):
        classes = np.full(len(plain), 9, np.uint8)
        facts = facts_of(plain, classes, ROAD)
        assert codes(pavement_doubts(ROAD, "published", facts, 0.005, 0.2), "refused") == {
            "pavement_water"
        }
        assert codes(pavement_doubts(ROAD, "user", facts, 0.005, 0.2)) == {"pavement_water"}

    def test_a_pavement_that_hangs_on_its_tolerance(self, plain):
        facts = facts_of(plain, outline=ROAD)
        for unsure, severity in ((0.3, "note"), (1.4, "doubt")):
            found = pavement_doubts(ROAD, "surface", facts, 0.005, 0.2, unsure_share=unsure)
            assert "pavement_unsure" in codes(found, severity)

    def test_road_points_of_the_file_off_the_pavement(self, plain):
        classes = np.where(plain[:, 1] < 6, 11, 2).astype(np.uint8)
        doubts = pavement_doubts(ROAD, "surface", facts_of(plain, classes, ROAD), 0.005, 0.2)
        assert codes(doubts) == {"pavement_own_road"}

    def test_fragments_and_what_they_miss(self, plain):
        pieces = MultiPolygon([box(x, 6, x + 6, 14) for x in (0, 10, 20)])
        doubts = pavement_doubts(pieces, "surface", facts_of(plain, outline=pieces), 0.005, 0.2)
        assert codes(doubts) == {"pavement_parts", "pavement_reach"}
        measured = {doubt.code: doubt.measured for doubt in doubts}
        assert measured["pavement_parts"] == pytest.approx(1 / 3, abs=0.01)
        assert measured["pavement_reach"] < 0.3

    def test_a_track_that_leaves_the_pavement(self, plain):
        track = np.array([[0.0, 10.0], [200.0, 10.0], [200.0, 210.0]])
        doubts = pavement_doubts(ROAD, "surface", facts_of(plain, outline=ROAD), 0.005, 0.2, track)
        assert codes(doubts) == {"pavement_track"}

    @pytest.mark.parametrize(
        ("method", "layer_m", "open_share", "code"),
        [
            ("surface", 0.045, 0.2, {"pavement_layer"}),
            ("surface", 0.02, 0.2, set()),
            ("published", 0.02, 0.2, {"pavement_layer"}),
            ("surface", 0.005, 0.7, {"pavement_open"}),
            ("user", 0.2, 0.9, set()),
        ],
    )
    def test_noise_and_unseen_edges(self, plain, method, layer_m, open_share, code):
        facts = facts_of(plain, outline=ROAD)
        assert codes(pavement_doubts(ROAD, method, facts, layer_m, open_share)) == code

    def test_sparse_points(self, plain):
        doubts = pavement_doubts(ROAD, "surface", facts_of(plain[::8], outline=ROAD), 0.005, 0.2)
        assert codes(doubts) == {"pavement_density"}

    def test_kerbs_confirm_an_outline_and_flat_ground_does_not(self, rng):
        count = 100_000
        x, y = rng.uniform(0, 60, count), rng.uniform(-10, 10, count)
        shares = []
        for kerb_m in (0.12, 0.0):
            z = np.where(np.abs(y) < 4, 0.0, kerb_m) + rng.normal(0, 0.004, count)
            facts = PavementFacts()
            outline = MultiPolygon([box(-1, -4, 61, 4)])
            facts.add_rim(np.column_stack([x, y, z]), outline, (0.0, -10.0, 60.0, 10.0))
            shares.append(facts.open_m / facts.outline_m)
            assert facts.layer_m == pytest.approx(0.004, rel=0.3)
        assert shares[0] < 0.1 and shares[1] > 0.9
