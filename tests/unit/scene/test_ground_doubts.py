import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.doubts import by_severity
from roadsight.scene.terrain.terrain import TerrainModel
from roadsight.stages.scene import build_dem as told
from roadsight.stages.scene.build_dem import ClassAgreement, ground_doubts, raised_settings

SHARES = st.floats(0, 1)
SEEDS = st.integers(0, 2**31)


def codes(doubts, severity):
    return {doubt.code for doubt in doubts if doubt.severity == severity}


def classes_of(seed, n=200):
    """Classes, ground labels and heights above the terrain, some of them unknown."""
    rng = np.random.default_rng(seed)
    above = rng.uniform(0, 4, n)
    above[rng.random(n) < 0.1] = np.nan
    return rng.choice([0, 1, 2, 5, 11], n).astype(np.uint8), rng.random(n) < 0.5, above


@given(ground=SHARES, filled=SHARES, noise=st.floats(0, 0.5))
def test_a_doubt_is_told_exactly_beyond_its_limit(ground, filled, noise):
    found = ground_doubts(ground, filled, noise, ClassAgreement())
    beyond = {
        "ground_share": ground < told._LEAST_GROUND,
        "dem_filled": filled > told._MOST_FILLED,
        "layer_noise": noise > told._MOST_NOISE_M,
    }
    assert codes(found, "doubt") == {code for code, is_beyond in beyond.items() if is_beyond}
    assert codes(found, "note") == {"ground_share", "dem_filled"} - codes(found, "doubt")
    assert len({doubt.code for doubt in found}) == len(found)
    assert all(doubt.limit is not None for doubt in found if doubt.severity == "doubt")
    ranks = ["doubt", "note"]
    order = [ranks.index(doubt.severity) for doubt in by_severity(found)]
    assert order == sorted(order)


@given(seed=SEEDS, cut=st.integers(0, 200))
def test_classes_are_counted_in_tiles_as_in_one_piece(seed, cut):
    classes, ground, above = classes_of(seed)
    whole, parts = ClassAgreement(), ClassAgreement()
    whole.add(classes, ground, above)
    for part in (slice(cut), slice(cut, None)):
        parts.add(classes[part], ground[part], above[part])
    assert parts == whole


@given(seed=SEEDS)
def test_classes_are_counted_as_by_hand(seed):
    classes, ground, above = classes_of(seed)
    counts = ClassAgreement()
    counts.add(classes, ground, above)
    own = [c in (2, 11) for c in classes]
    by_hand = ClassAgreement(
        points=sum(c not in (0, 1) for c in classes),
        disagree=sum(o != g for o, g, c in zip(own, ground, classes, strict=True) if c > 1),
        own_ground=sum(own),
        high=sum(o and h > 2 for o, h in zip(own, above, strict=True)),
    )
    assert counts == by_hand


@given(seed=SEEDS, flip=SHARES)
def test_files_that_disagree_on_low_plants_are_not_doubted_and_single_classes_are(seed, flip):
    rng = np.random.default_rng(seed)
    ground = rng.random(2000) < 0.5
    above = np.where(ground, 0.0, rng.uniform(3, 20, 2000))
    swapped = ground ^ (rng.random(2000) < 0.1 * flip)
    beside = np.where(swapped, np.minimum(above, 0.5), above)
    agree, single, silent = ClassAgreement(), ClassAgreement(), ClassAgreement()
    agree.add(np.where(swapped, 2, 5).astype(np.uint8), ground, beside)
    single.add(np.full(2000, 2, np.uint8), ground, above)
    silent.add(np.ones(2000, np.uint8), ground, above)
    assert not codes(ground_doubts(0.5, 0.0, 0.0, agree), "doubt")
    assert not codes(ground_doubts(0.5, 0.0, 0.0, silent), "doubt")
    assert codes(ground_doubts(0.5, 0.0, 0.0, single), "doubt") == {"classes_contradict"}


@given(asked=st.floats(0.1, 10), used=st.floats(0.1, 10))
def test_only_raised_settings_are_told(asked, used):
    found = raised_settings({"cell_m": asked}, {"cell_m": used})
    assert [doubt.code for doubt in found] == ["raised_cell_m"] * (used > asked)


@given(seed=SEEDS, cuts=st.integers(1, 5))
def test_measured_cells_hold_ground_points_in_whatever_tiles_they_come(seed, cuts):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 9, (60, 3))
    terrain = TerrainModel((0.0, 0.0, 9.0, 9.0), 1.0)
    for part in np.array_split(points, cuts):
        terrain.add(part)
    cells = {(int(y), int(x)) for x, y, _ in points}
    assert set(map(tuple, np.argwhere(terrain.measured).tolist())) == cells
    heights = terrain.heights_m(3.0)
    assert np.isfinite(heights[terrain.measured]).all()
    for row, column in cells:
        own = [z for x, y, z in points if (int(y), int(x)) == (row, column)]
        assert heights[row, column] == pytest.approx(np.mean(own), abs=1e-4)
    assert 0 <= terrain.filled_share() < 1
