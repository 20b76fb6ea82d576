"""A drive of fewer images than shards, with default settings, through the whole workflow."""

import json

import pytest

from roadsight.io.records.tables import read_table
from tests.properties.poles_job import LABELS, PolesJob, make_lane
from tests.workflow.conftest import Checkout

SITE = """\
site: short
title: Short drive
clouds: [short/cloud.laz]
crs: EPSG:32617
vertical_units: metre
jobs: [poles]
poles:
  videolog: short/videolog.csv
  images: short/images
  road: classes
  masks:
    - labels: short/masks
      map: {labels}
  depth:
    images: short/depth
"""


@pytest.mark.full
def test_every_step_takes_a_shard_without_images(tmp_path):
    """Three images in the four shards that are usual; drives of 2 and 5: tests/properties."""
    checkout = Checkout.copy_to(tmp_path / "checkout", "short")
    sites = checkout.folder / "config/sites"
    lane, shown = make_lane(images=3)
    PolesJob(sites / "short", shown).write(lane)
    (sites / "short.yaml").write_text(SITE.format(labels=LABELS))
    result = checkout.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-8000:]
    folder = checkout.folder / "results/short"
    cameras = [read_table(folder / f"poles/cameras/{shard}.parquet") for shard in range(4)]
    assert sorted(map(len, cameras)) == [0, 1, 1, 1]
    summary = json.loads((folder / "summary.json").read_text())["poles"]
    assert summary["images"] == 3
    assert (folder / "poles/page.json").exists()
