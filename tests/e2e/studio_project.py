"""A project with two small sites and finished results, and a studio that serves it."""

import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[2]
from roadsight.io.records.tables import read_table, write_table  # noqa: E402
from tests.helpers.report_poles import WIDTH_PX, PolesSite  # noqa: E402
from tests.helpers.report_site import ReportSite  # noqa: E402

SITES = {
    "tiny": {"title": "Tiny road", "jobs": ["placement"]},
    "drive": {"title": "Tiny drive", "jobs": ["poles"]},
    "empty": {"title": "Nothing yet", "jobs": ["placement"]},
}
SETTINGS = {"shards": 1, "coverage": {"shards": 1, "uncoverable": "exclude"}}


def make_project(folder, poles=True):
    """A project's folder with the workflow, its configuration and results."""
    shutil.copytree(ROOT / "config", folder / "config", ignore=shutil.ignore_patterns("sites"))
    for name in ("workflow", "envs", "resources", "profiles"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copyfile(ROOT / "Snakefile", folder / "Snakefile")
    config = folder / "config" / "config.yaml"
    config.write_text(
        config.read_text().replace("sites: [sample, sample_rural]", "sites: [tiny, drive, empty]")
    )
    (folder / "config" / "sites").mkdir()
    for name, about in SITES.items():
        clouds = ["clouds/road.laz"]
        site = {"site": name, **about, "clouds": clouds, "settings": SETTINGS}
        if "poles" in about["jobs"]:
            manifest = "../../resources/manifests/road_classes.yaml"
            site["poles"] = {"videolog": "videolog.csv", "images": "../../results/drive/images"}
            site["poles"]["masks"] = [{"model": manifest}]
            site["settings"] = SETTINGS | {"shards": 2}
        text = f"# The site {name}\n" + yaml.safe_dump(site, sort_keys=False)
        (folder / "config" / "sites" / f"{name}.yaml").write_text(text)
    ReportSite(folder / "results", "tiny", hidden=0.1, points=60_000)
    if poles:
        PolesSite(folder / "results", "drive", length_m=160.0, poles=8)
        _tell_sides(folder / "results/drive/poles/image_edges")
    return folder


def _tell_sides(folder):
    """Sides and kinds of edge pixels, which the report does not look at."""
    for path in folder.glob("*.parquet"):
        table = read_table(path)
        side = np.where(table["u"] < 0.5 * WIDTH_PX, -1, 1)
        write_table(path, table.assign(side=side, kind="border"))


class Studio:
    """A studio in a process of its own.

    Attributes
    ----------
    folder : of the project. address : with the token. log : file of what it says.

    Parameters
    ----------
    browser : program that it is to open its page with; None: it opens none.
    """

    def __init__(self, folder, log, browser=None):
        self.folder, self.log = folder, log
        environment = os.environ | {"PYTHONPATH": str(ROOT / "workflow"), "BROWSER": str(browser)}
        with log.open("wb") as stream:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "roadsight", "studio", "--port", "0"]
                + ([] if browser else ["--no-browser"]),
                cwd=folder, env=environment, stdout=stream, stderr=stream,
                # Tests that run in the background ignore Ctrl+C; the studio is not to inherit that.
                preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
            )  # fmt: skip
        self.address = self._wait()

    def _wait(self):
        end = time.monotonic() + 60
        while time.monotonic() < end:
            words = self.log.read_text().split()
            if found := [word for word in words if word.startswith("http://") and "#" in word]:
                return found[0]
            assert self.process.poll() is None, self.log.read_text()
            time.sleep(0.05)
        raise AssertionError(self.log.read_text())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait()
