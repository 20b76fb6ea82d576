from dataclasses import replace

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight_worlds.rendering.images import RuralRenderer
from roadsight_worlds.rural.airborne_scanner import AirborneScanner, Returns, scan_rural
from roadsight_worlds.rural.rural_materials import CLOUD_OF_GROUND
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.rural_surface import ground_kinds

SCANNER = AirborneScanner(pulses_per_m2=10.0)


@pytest.fixture(scope="module")
def renderer():
    return RuralRenderer(build_rural(6, 120.0, detail=0.05))


@pytest.fixture(scope="module")
def cloud(renderer):
    parts = list(scan_rural(renderer, np.random.default_rng(1), SCANNER))
    columns = Returns.__dataclass_fields__
    return Returns(*(np.concatenate([getattr(p, name) for p in parts]) for name in columns))


def of_kind(renderer, cloud, kind):
    numbers = [i for i, k in enumerate(renderer.site.kinds) if k == kind]
    return np.isin(cloud.object_id, numbers)


def test_density_and_corridor(renderer, cloud):
    first = cloud.return_number == 1
    assert first.sum() == pytest.approx(10.0 * 120.0 * 160.0, rel=0.02)
    road = renderer.site.line.road(cloud.xyz_m[:, :2])
    assert np.abs(road[:, 1]).max() < 66.0
    assert np.abs(cloud.scan_angle_deg).max() < 15.0
    assert set(cloud.line) == {1, 2}


def test_ground_points_lie_on_the_ground_within_the_noise(renderer, cloud):
    road = renderer.site.line.road(cloud.xyz_m[:, :2])
    flat = np.isin(cloud.classification, (11,)) & (np.abs(road[:, 1]) < 3.0)
    error = cloud.xyz_m[flat, 2] - renderer.site.ground.height(*road[flat].T)
    assert error.std() == pytest.approx(np.hypot(0.02, 0.02), rel=0.1)
    assert abs(error.mean()) < 0.003


def test_classes_are_those_of_the_surfaces(renderer, cloud):
    site = renderer.site
    ground = of_kind(renderer, cloud, "ground")
    road = site.line.road(cloud.xyz_m[ground, :2])
    inner = np.abs(np.abs(road[:, 1]) - site.ground.section.pavement_m) > 1.2
    branch = np.zeros(len(road), bool)
    for b in site.ground.branches:  # the noise moves points across a branch's edge
        along, across = b.along_across(cloud.xyz_m[ground, :2])
        branch |= (np.abs(across) < b.half_m + b.radius_m + 0.2) & (np.abs(along) < b.length_m + 2)
    gully = np.abs(np.abs(road[:, 0] - site.ground.gully_m) - site.ground.bridge_half_m) < 0.2
    sure = inner & ~branch & ~gully & (np.abs(np.abs(road[:, 1]) - 4.95) > 0.2)
    kinds = ground_kinds(site.surface, cloud.xyz_m[ground, :2], road, lines=False)
    got = cloud.classification[ground]
    assert (got == CLOUD_OF_GROUND[kinds])[sure].all()
    assert {2, 11, 17} <= set(got)


def test_about_one_in_a_hundred_is_wrong_at_the_edge(renderer, cloud):
    site = renderer.site
    ground = of_kind(renderer, cloud, "ground")
    road = site.line.road(cloud.xyz_m[ground, :2])
    gap = np.abs(road[:, 1]) - site.ground.section.pavement_m
    bare = np.ones(len(road), bool)
    for b in site.ground.branches:
        bare &= np.abs(road[:, 0] - b.station_m) > b.half_m + b.radius_m + 4.0
    bare &= np.abs(road[:, 0] - site.ground.gully_m) > 8.0
    near = bare & (np.abs(gap) < 0.9) & (np.abs(gap) > 0.15)
    wrong = (cloud.classification[ground] == 11) != (gap < 0.0)
    assert near.sum() > 1500
    assert 0.003 < wrong[near].mean() < 0.02


def test_poles_and_wires_are_called_vegetation(renderer, cloud):
    for kind in ("utility pole", "wire"):
        points = of_kind(renderer, cloud, kind)
        assert points.sum() > 5
        assert set(cloud.classification[points]) <= {3, 4, 5}
    assert set(cloud.classification[of_kind(renderer, cloud, "house")]) == {6}


def test_vegetation_is_classed_by_height(renderer, cloud):
    plants = np.isin(cloud.classification, (3, 4, 5))
    above = cloud.xyz_m[plants, 2] - renderer.site.height(cloud.xyz_m[plants, :2])
    classes = cloud.classification[plants]
    assert above[classes == 3].max() < 0.7
    assert above[classes == 4].min() > 0.3 and above[classes == 4].max() < 2.2
    assert above[classes == 5].min() > 1.8


def test_returns_are_counted(cloud):
    assert (cloud.return_number <= cloud.number_of_returns).all()
    assert cloud.number_of_returns.max() > 1
    several = cloud.number_of_returns > 1
    starts = several & (cloud.return_number == 1)
    assert several.sum() == cloud.number_of_returns[starts].sum()


def test_the_same_seed_gives_the_same_points(renderer):
    few = AirborneScanner(pulses_per_m2=0.5)
    one, two, other = (
        next(scan_rural(renderer, np.random.default_rng(seed), few)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.xyz_m, two.xyz_m)
    np.testing.assert_array_equal(one.classification, two.classification)
    assert one.xyz_m.shape != other.xyz_m.shape or (one.xyz_m != other.xyz_m).any()


def test_no_density_is_refused(renderer):
    with pytest.raises(InputError, match="pulses_per_m2"):
        next(scan_rural(renderer, np.random.default_rng(1), AirborneScanner(pulses_per_m2=0.0)))


def test_a_survey_may_miss_the_poles(renderer, cloud):
    scanner = replace(SCANNER, hits_poles=False)
    rng = np.random.default_rng(1)
    found = np.concatenate([part.object_id for part in scan_rural(renderer, rng, scanner)])
    thin = np.concatenate([of_kind(renderer, cloud, k) for k in ("utility pole", "wire")])
    assert thin.any()
    numbers = [i for i, k in enumerate(renderer.site.kinds) if k in ("utility pole", "wire")]
    assert not np.isin(found, numbers).any()
    assert len(found) > 0.98 * len(cloud.object_id)


@pytest.mark.parametrize(
    ("scheme", "wire", "pole", "road"),
    [("none", {0}, {0}, 0), ("unclassified", {1}, {1}, 1), ("lines", {14}, {15}, 11)],
)
def test_classes_of_other_producers(renderer, scheme, wire, pole, road):
    scanner = AirborneScanner(pulses_per_m2=10.0, class_scheme=scheme)
    parts = list(scan_rural(renderer, np.random.default_rng(1), scanner))
    classes, objects = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("classification", "object_id")
    )
    kinds = np.array(renderer.site.kinds)[objects]
    assert set(classes[kinds == "wire"]) == wire
    assert set(classes[kinds == "utility pole"]) == pole
    assert (classes[kinds == "ground"] == road).any()
