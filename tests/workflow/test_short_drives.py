"""Drives of fewer images than shards, with default settings, through the whole workflow."""

from __future__ import annotations

import json

import pytest

from roadsight.io.records.tables import read_table
from tests.properties.poles_job import LABELS, PolesJob, make_lane
from tests.workflow.conftest import Checkout

pytestmark = pytest.mark.full
IMAGES = (2, 3, 5)
SITE = """\
site: short{images}
title: Short drive
clouds: [short{images}/cloud.laz]
crs: EPSG:32617
vertical_units: metre
jobs: [poles]
poles:
  videolog: short{images}/videolog.csv
  images: short{images}/images
  road: classes
  masks:
    - labels: short{images}/masks
      map: {labels}
  depth:
    images: short{images}/depth
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    checkout = Checkout.copy_to(tmp_path_factory.mktemp("short") / "checkout")
    sites = checkout.folder / "config/sites"
    for images in IMAGES:
        lane, shown = make_lane(images=images)
        PolesJob(sites / f"short{images}", shown).write(lane)
        text = SITE.format(images=images, labels=LABELS)
        (sites / f"short{images}.yaml").write_text(text)
    names = ",".join(f"short{images}" for images in IMAGES)
    result = checkout.snakemake("--cores", "2", "--config", f"sites=[{names}]")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-8000:]
    return checkout


@pytest.mark.parametrize("images", IMAGES)
def test_every_step_takes_shards_without_images(checkout, images):
    folder = checkout.folder / f"results/short{images}"
    cameras = [read_table(folder / f"poles/cameras/{shard}.parquet") for shard in range(4)]
    assert sorted(map(len, cameras)) == sorted(images // 4 + (k < images % 4) for k in range(4))
    summary = json.loads((folder / "summary.json").read_text())["poles"]
    assert summary["images"] == images
    assert (folder / "poles/page.json").exists()
