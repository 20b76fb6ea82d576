"""Every option of every verb takes part in a real call that succeeds."""

import argparse
import json
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import sparse

from roadsight.__main__ import build_parser, main
from roadsight.evidence.estimate import SHIPPED
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.io.cloud.clouds import write_laz
from tests.conftest import PROJECT
from tests.helpers.small_workflow import small_project
from tests.options.registry import Finished
from tests.properties.placement_job import SENSORS
from tests.properties.poles_job import LABELS, LENS, place
from tests.unit.commands.test_accept_verb import FRAME, PLACE_M, scan, street, write_plan

pytestmark = pytest.mark.xdist_group("every_option")
LOCAL = "--crs local --units metre --vertical-units metre --overlap use"
GRID = "--crs EPSG:32617 --units metre --vertical-units metre --overlap use"
ROAD = "--method surface --intensity auto --engine own --seed 2 --seeds 6,0;40,0"
NETWORK = PROJECT / "resources/models/depth_unet.onnx"
VIEW = "--videolog {lane}/videolog.csv --cloud {lane}/cloud.laz --images {lane}/images"
CALLS = {
    "init": "init {street}/cloud.laz --site mine --force -o {out}/mine.yaml",
    "ground": "ground {street}/cloud.laz --pillar-width-m 0.25 --height-threshold-m 0.12"
    " --coarse-cell-m 0.5 --max-object-width-m 20 --slope 0.3 --coarse-tolerance-m 0.3"
    f" {LOCAL} -o {{out}}/ground.laz",
    "ground by pillars": f"ground {{street}}/cloud.laz --method pillars {LOCAL} -o {{out}}/low.laz",
    "pavement": f"pavement {{street}}/cloud.laz {LOCAL} {ROAD} --track {{files}}/track.csv"
    " -o {out}/pavement.laz",
    "edges": f"edges {{street}}/cloud.laz {LOCAL} {ROAD} --track {{files}}/track.csv"
    " -o {out}/edges.gpkg",
    "geometry": f"geometry {{street}}/cloud.laz {LOCAL} {ROAD} --track {{files}}/track.csv"
    " --along {files}/track.csv --edges {files}/edges.csv -o {out}/geometry.gpkg",
    "depthmap": f"depthmap {{street}}/cloud.laz {LOCAL} --sensor OS-32 --at 24 0 6 --model surfel"
    f" --engine own --outlier-radius-m 0.5 --sensors {SENSORS} --azimuth-deg 10 -o {{out}}/map.npz",
    "depthmap by a network": f"depthmap {{street}}/cloud.laz {LOCAL} --sensor OS-32 --at 24 0 6"
    f" --model unet --network {NETWORK} -o {{out}}/unet.npz",
    "cover": "cover {files}/cover.npz --costs {files}/costs.npy --groups {files}/groups.npy"
    " --needs {files}/needs.npy --mandatory {files}/mandatory.npy --forbidden {files}/forbidden.npy"
    " --positions {files}/positions.npy --spacing 0.5 --alternatives --second 5 --time-limit 20"
    " --seed 2 -o {out}/cover.json",
    "cover by HiGHS": "cover {files}/cover.npz --solver highs --verify 20 -o {out}/whole.json",
    "cover twice": "cover {files}/cover.npz --at-least 2 -o {out}/twice.json",
    "cover with failures": "cover {files}/cover.npz --keep-share 0.5 -o {out}/share.json",
    "cover for a price": "cover {files}/cover.npz --price 0.4 --weights {files}/weights.npy"
    " -o {out}/price.json",
    "cover for a budget": "cover {files}/cover.npz --budget 3 --weights {files}/weights.npy"
    " --curve 3 -o {out}/budget.json",
    "accept": "accept {files}/scan.laz --plan {plan}/solution.json --sensor 1 --move-m 0.4"
    " --turn-deg 2 --scans {plan}/scans.laz --frame {files}/results/scene/frame.json"
    " --sensors {files}/results/sensors.yaml -o {out}/accept.json",
    "align": "align {lane}/videolog.csv --cloud {lane}/cloud.laz --images {lane}/images"
    f" --masks {{lane}}/masks --map {LABELS} --hfov-deg 60 --method road --engine own"
    f" --max-sigma-heading-deg 0.5 {GRID} -o {{out}}/cameras.csv",
    "align from a baseline": "align {lane}/videolog.csv --cloud {lane}/cloud.laz"
    f" --images {{lane}}/images --masks {{lane}}/masks --map {LABELS}"
    f" --baseline {{files}}/baseline.json {GRID} -o {{out}}/based.csv",
    "align with a lens": "align {lane}/videolog.csv --cloud {lane}/cloud.laz"
    f" --images {{lane}}/images --masks {{lane}}/masks --map {LABELS}"
    f" --intrinsics {{files}}/lens.csv --method auto {GRID} -o {{out}}/lens.csv",
    "register": f"register {{files}}/pairs.csv {VIEW} --engine own {GRID} -o {{out}}/baseline.json",
    "triangulate": "triangulate {files}/sightings.csv --max-distance-m 40 --sigma-position-m 0.5"
    " --sigma-bearing-deg 0.5 --sigma-depth-ratio 0.2 --max-sigma-m 5 --depths-as-given"
    " -o {out}/poles.csv",
    "triangulate as published": "triangulate {files}/sightings.csv --published --seed 3"
    " -o {out}/published.csv",
    "changes": "changes {files}/poles.csv {files}/later.csv --reach-m 3 --sigmas 2 --sigma-m 0.3"
    " -o {out}/changes.csv",
    "draw": "draw {files}/poles.csv --count 5 --by sigma_major_m --seed 4 -o {out}/checks.csv",
    "score": "score {files}/checks.csv -o {out}/score.json",
    "estimate": "estimate --miles 20 --run-miles 5 --job placement --job poles --points-m 30"
    " --candidates 500 --targets 4000 --images 300 --sensors 2 --plans 2 --shards 4 --cores 2"
    " --costs {costs} -o {out}/estimate.json",
    "estimate of a site": "estimate sample -o {out}/site.json",
}
"""Calls by name; ``{street}``, ``{lane}``: finished sites, ``{files}``: what is written below."""
NO_CURBS = {
    "align in a street": "align {lane}/videolog.csv --cloud {lane}/cloud.laz"
    f" --images {{lane}}/images --masks {{lane}}/masks --map {LABELS} --street {GRID}"
    " -o {out}/street.csv",
    "register in a street": f"register {{files}}/pairs.csv {VIEW} --street {GRID}"
    " -o {out}/street.json",
}
"""Calls that end in one message: the lane has no curbs, which `--street` looks for."""
BY_HAND = {
    ("studio", "folder"): "test_studio_serves",
    ("studio", "port"): "test_studio_serves",
    ("studio", "no_browser"): "test_studio_serves",
    ("estimate", "fit"): "tests/unit/evidence/test_costs.py::test_a_model_of_ones_own",
}
"""Options that a test of their own calls."""


@pytest.fixture(scope="session")
def folders(finished: Finished, tmp_path_factory) -> dict[str, str]:
    files, out = (tmp_path_factory.mktemp(name) for name in ("files", "out"))
    plan = write_plan(files / "results")
    _write_scan(files)
    _write_lines(files)
    _write_cover(files)
    _write_poles(files)
    _write_views(files, finished)
    return {
        "street": str(finished.street.folder), "lane": str(finished.poles.folder),
        "files": str(files), "out": str(out), "plan": str(plan), "costs": str(SHIPPED),
    }  # fmt: skip


def _write_scan(files: Path) -> None:
    moved = PLACE_M + np.array([0.1, 0.0, 0.05])
    write_laz(files / "scan.laz", scan(moved, street(0)) - moved + PLACE_M, FRAME)


def _write_lines(files: Path) -> None:
    x = np.linspace(2, 46, 12)
    pd.DataFrame({"edge": "d", "x": x, "y": -1.8}).to_csv(files / "track.csv", index=False)
    sides = [pd.DataFrame({"edge": str(y), "x": x, "y": y}) for y in (-4.0, 4.0)]
    pd.concat(sides).to_csv(files / "edges.csv", index=False)


def _write_cover(files: Path) -> None:
    rng = np.random.default_rng(5)
    matrix = rng.random((14, 40)) < 0.4
    sparse.save_npz(files / "cover.npz", sparse.csr_matrix(matrix))
    arrays = {
        "costs": rng.integers(1, 4, 14).astype(float), "groups": np.repeat(np.arange(7), 2),
        "needs": np.ones(40, int), "mandatory": np.array([0]), "forbidden": np.array([13]),
        "positions": np.column_stack([np.arange(14.0), np.zeros(14)]),
        "weights": rng.uniform(0.5, 2.0, 40),
    }  # fmt: skip
    for name, values in arrays.items():
        np.save(files / f"{name}.npy", values)


def _write_poles(files: Path) -> None:
    rng = np.random.default_rng(6)
    step = 1 / 111_320
    poles = pd.DataFrame({"id": range(12), "latitude": 35.0 + 20 * step * np.arange(12)})
    poles["longitude"], poles["sigma_major_m"] = -80.0, rng.uniform(0.1, 1.0, 12)
    poles.to_csv(files / "poles.csv", index=False)
    poles.assign(latitude=poles["latitude"] + step).iloc[1:].to_csv(
        files / "later.csv", index=False
    )
    cameras = 35.0 + 4 * step * np.arange(50)
    rows = []
    for number, camera in enumerate(cameras):
        gap = (poles["latitude"] - camera) / step
        for north in gap[(gap > 3) & (gap < 25)]:
            bearing = np.degrees(np.arctan2(5.0, north))
            rows.append((f"i{number}", camera, -80.0, bearing, np.hypot(5.0, north)))
    drawn = poles.iloc[:4]
    sheet = pd.DataFrame({"id": drawn["id"], "stratum": "all", "stratum_size": 12})
    for axis in ("latitude", "longitude"):
        sheet[f"found_{axis}"] = sheet[axis] = drawn[axis]
    sheet.assign(verdict="pole", note="").to_csv(files / "checks.csv", index=False)
    names = ["image", "lat", "lon", "bearing", "depth"]
    pd.DataFrame(rows, columns=names).to_csv(files / "sightings.csv", index=False)


def _write_views(files: Path, finished: Finished) -> None:
    """Pairs that show the found camera of the lane, its lens and a baseline."""
    camera = finished.poles.cameras.iloc[3]
    origin = finished.lane.xyz.min(axis=0)
    spots = place(24.0 + np.array([10.0, 16, 24, 34, 46, 12, 20, 30]), np.tile([-3.2, 3.2], 4))
    points = np.column_stack([spots, 100.0 + 0.01 * spots[:, 1]])
    points[::3, 2] += 4.0
    rotation = cam_from_world(*camera[["heading_deg", "pitch_deg", "roll_deg"]].astype(float))
    lens = Intrinsics.centred(LENS.width_px, LENS.height_px, float(camera["focal_px"]))
    at = camera[["x", "y", "z"]].to_numpy(float) + origin
    uv, _ = project(lens, rotation, at, points)
    native = np.add(points, [finished.lane.east_m, 4_000_000.0, 0.0])
    table = pd.DataFrame(np.column_stack([uv, native]), columns=["pixel_x", "pixel_y", *"xyz"])
    inside = lens.contains(uv)
    table[inside].assign(image=camera["image"]).to_csv(files / "pairs.csv", index=False)
    size = f"{LENS.width_px}x{LENS.height_px}"
    mount = {
        "focal_px": LENS.focal_px, "height_m": 2.3, "pitch_deg": -2.5, "roll_deg": 0.3,
        "yaw_deg": 0.8,
    }  # fmt: skip
    (files / "baseline.json").write_text(json.dumps({size: mount}))
    about = {"fx_px": [LENS.focal_px], "cx_px": [LENS.cx_px], "cy_px": [LENS.cy_px]}
    pd.DataFrame(about).to_csv(files / "lens.csv", index=False)


def options_of(parser: argparse.ArgumentParser) -> dict[str, set[str]]:
    """Names of the options of each verb."""
    (verbs,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return {
        name: {action.dest for action in verb._actions if action.option_strings} - {"help"}
        for name, verb in verbs.choices.items()
    }


def used_options() -> set[tuple[str, str]]:
    """Verbs and options that the calls use."""
    flags = {
        (name, flag): action.dest
        for name, verb in _verbs().items()
        for action in verb._actions
        for flag in action.option_strings
    }
    words = [call.split() for call in (CALLS | NO_CURBS).values()]
    return {(verb, flags[verb, word]) for verb, *rest in words for word in rest
            if (verb, word) in flags}  # fmt: skip


def _verbs() -> dict[str, argparse.ArgumentParser]:
    (verbs,) = (a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(verbs.choices)


def test_every_option_of_every_verb_is_called():
    """Add an option to a call of its verb in CALLS, or a call."""
    every = {(verb, name) for verb, names in options_of(build_parser()).items() for name in names}
    assert every - used_options() - set(BY_HAND) == set()


@pytest.mark.full
@pytest.mark.parametrize("name", CALLS)
def test_call(folders, name, monkeypatch):
    monkeypatch.chdir(PROJECT)
    argv = [part.format(**folders) for part in CALLS[name].split()]
    assert main(argv) == 0
    out = Path(argv[argv.index("-o") + 1])
    assert out.stat().st_size > 0


@pytest.mark.full
@pytest.mark.parametrize("name", NO_CURBS)
def test_a_street_without_curbs_is_one_message(folders, name, capsys):
    argv = [part.format(**folders) for part in NO_CURBS[name].split()]
    assert main(argv) == 2
    assert "no curb found" in capsys.readouterr().err


@pytest.mark.full
def test_studio_serves(tmp_path):
    """On any free port, in a folder of its own, without a browser; a signal ends it."""
    argv = [sys.executable, "-m", "roadsight", "studio", "--folder", str(small_project(tmp_path))]
    argv += ["--port", "0", "--no-browser"]
    studio = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert studio.stdout is not None
        told = next(line for line in studio.stdout if "http://" in line)
        address = re.search(r"http://\S+", told)
        assert address is not None
        with urllib.request.urlopen(address[0], timeout=60) as answer:
            assert answer.status == 200
    finally:
        studio.terminate()
        studio.wait(60)
