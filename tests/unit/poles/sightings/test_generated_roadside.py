import numpy as np
import pytest
import shapely

from roadsight.poles.images.kinds import KINDS
from roadsight.poles.risk.validation import score_lines, score_near
from roadsight.poles.sightings.buildings import block_cells, join_blocks
from roadsight.poles.sightings.rails import find_rail_returns, join_rails
from roadsight.poles.sightings.trees import find_crowns
from roadsight_worlds.rendering.images import RuralRenderer
from roadsight_worlds.rural.airborne_scanner import AirborneScanner, scan_rural
from roadsight_worlds.rural.rural_road import build_rural


@pytest.fixture(scope="module", params=[11, 12])
def scanned(request):
    """Site, returns, their heights above the true ground, classes; 55 m about a road of 200 m."""
    site = build_rural(request.param, 200.0)
    rng = np.random.default_rng(request.param)
    parts = list(scan_rural(RuralRenderer(site), rng, AirborneScanner(pulses_per_m2=24.0)))
    xyz = np.concatenate([part.xyz_m for part in parts])
    cls = np.concatenate([part.classification for part in parts])
    road = site.line.road(xyz[:, :2])
    near = (np.abs(road[:, 1]) < 55.0) & (road[:, 0] > 0.0) & (road[:, 0] < 200.0)
    return site, xyz[near], xyz[near, 2] - site.height(xyz[near, :2]), cls[near]


def test_trees_are_found_where_their_trunks_stand(scanned):
    site, xyz, above, cls = scanned
    found, truth = (
        find_crowns(xyz, above, cls, 0.5).xy_m,
        np.array([t.xyz_m[:2] for t in site.trees]),
    )
    counts = []
    for places in (found, truth):
        station, offset = site.line.road(places).T
        counts.append((np.abs(offset) < 30.0) & (station > 5.0) & (station < 195.0))
    scores = score_near(found, truth, *counts)
    assert counts[1].sum() >= 10
    assert scores["recall"] > 0.8 and scores["f1"] > 0.85


def test_guardrails_are_found_by_length_and_nothing_else_is(scanned):
    site, xyz, above, cls = scanned
    lines = join_rails(find_rail_returns(xyz, above, cls))
    scores = score_lines([line[:, :2] for line in lines], [r[:, :2] for r in site.guardrails])
    assert scores["recall"] > 0.9 and scores["f1"] > 0.9


def test_buildings_are_found_where_their_eaves_are(scanned):
    site, xyz, _, cls = scanned
    found = join_blocks([block_cells(xyz[cls == 6])], KINDS["building"])
    whole = [
        shapely.Polygon(corners[:, :2])
        for corners in site.buildings
        if np.abs(site.line.road(corners[:, :2])[:, 1]).max() < 54.0
    ]
    assert whole
    for truth in whole:
        shares = [
            truth.intersection(one).area / truth.union(one).area
            for one in (shapely.Polygon(block.outline_m) for block in found)
        ]
        assert max(shares) > 0.8
