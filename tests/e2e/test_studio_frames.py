"""Five million points: all of them are shown at rest, and moving stays smooth."""

import statistics

import numpy as np
import pytest

from roadsight.io.cloud.tile_writer import TileWriter
from tests.e2e.chromium import BINARY, Chromium
from tests.e2e.studio_page import open_studio
from tests.e2e.studio_project import Studio, make_project

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(BINARY is None, reason="no Chromium to open the studio with"),
    pytest.mark.xdist_group("studio"),
]
POINTS = 5_000_000
# Without a graphics card, on two cores that are busy with other work; a card needs far less.
SLOWEST_MS = 200
MOVES = 3
"""The fastest of them counts: other work on the machine only ever slows the page."""
MOVE = """new Promise((done) => {
    const { view } = studio.page, ends = [];
    let turns = 0;
    const next = (now) => {
        if (view.stats.frames.length > ends.length) ends.push(now);
        if (ends.length > 40) done(ends.slice(10).map((end, k) => end - ends[k + 9]));
        else requestAnimationFrame(next);
        view.pan(++turns % 40 < 20 ? 6 : -6, 1);
    };
    view.stats.frames = [];
    requestAnimationFrame(next);
})"""
"""Milliseconds from the end of each drawn frame to that of the next, while the view moves."""


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studio")
    project = make_project(folder / "project", poles=False)
    rng = np.random.default_rng(5)
    xy = rng.uniform([0, 0], [75, 45], (POINTS, 2)).astype(np.float32)
    zero = np.zeros(POINTS, np.uint8)
    columns = dict.fromkeys(("classification", "return_number", "number_of_returns"), zero)
    columns |= {"x": xy[:, 0], "y": xy[:, 1], "z": rng.gamma(1.0, 1.0, POINTS).astype(np.float32)}
    with TileWriter(project / "results/tiny/scene/cloud.parquet", 50, False) as writer:
        writer.append(columns | {"intensity": zero.astype(np.uint16)})
        writer.finish()
    with Studio(project, folder / "log") as started:
        yield started


@pytest.mark.parametrize("mode", ["plan", "3d"])
def test_five_million_points(studio, tmp_path, mode):
    with Chromium(tmp_path / "profile") as browser:
        page = open_studio(browser, studio, "edges/tiny", "studio.page?.view")
        page.run("studio.page.view.setAll(true)")
        page.run(f"studio.page.setMode('{mode}')")
        page.until("studio.page.view.settled && studio.page.view.stats.points > 4.9e6", 200)
        frames = min((sorted(page.run(MOVE)) for _ in range(MOVES)), key=statistics.median)
        median, late = statistics.median(frames), frames[len(frames) * 95 // 100]
        told = f"median {median:.0f} ms, 95 % {late:.0f} ms"
        print(f"{mode}: {told}")
        assert median < SLOWEST_MS, told
        page.until("studio.page.view.settled && studio.page.view.stats.points > 4.9e6", 200)
