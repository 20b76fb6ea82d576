"""Results and caches that are cut off or rotten are noticed, with one message that says what to do.

A changed input is noticed too, whether it changes between two runs or during one.
"""

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import read_top
from roadsight.io.records.atomic import read_json
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.scene_tables import read_terrain
from roadsight.io.records.tables import read_about, read_table
from roadsight.io.vector.vectors import read_layer
from tests.faults.disturb import Disturbed, check_same, digests

FRAME = Frame((0.0, 0.0, 0.0))
LAYERS = {"pavement": "pavement", "edges": "edges", "road_edges": "road_edges"}


def read_parquet(path):
    if "depth" in path.parts:
        return list(DepthMaps(path))
    if path.name == "cloud.parquet":
        return CloudTiles(path).read()
    return read_about(path), read_table(path)


def read_zip(path):
    shard = ImageShard(path)
    return [shard.read(name) for name in shard.names]


def read_gpkg(path):
    return read_layer(path, LAYERS[path.stem], FRAME)


def read_tif(path):
    return read_top(path, FRAME) if path.name == "top.tif" else read_raster(path, FRAME)


READERS = {
    ".parquet": read_parquet, ".zip": read_zip, ".json": read_json, ".tif": read_tif,
    ".npz": read_terrain, ".gpkg": read_gpkg,
}  # fmt: skip


def intermediate_results(checkout):
    """Results that other rules read, with their readers."""
    folder = checkout.folder / "results" / checkout.site
    for path in sorted(folder.rglob("*")):
        skipped = {"images", "benchmarks"} & set(path.parts)
        if path.suffix == ".gpkg" and path.stem not in LAYERS:
            continue
        if path.suffix in READERS and path.name != "truth.gpkg" and not skipped:
            yield path, READERS[path.suffix]


def check_cut_off(checkout, tmp_path):
    kinds = set()
    for path, read in intermediate_results(checkout):
        kinds.add(path.suffix)
        content = path.read_bytes()
        # The name stays, because readers go by it; the folder stays for the same reason.
        copy = tmp_path / path.relative_to(checkout.folder)
        copy.parent.mkdir(parents=True, exist_ok=True)
        for share in (0.0, 0.3, 0.9):
            kept = content[: int(len(content) * share)]
            if kept.strip() == content.strip():
                continue  # an empty list lost the end of its line
            copy.write_bytes(kept)
            with pytest.raises(InputError) as error:
                read(copy)
            assert str(copy) in str(error.value), path
    return kinds


def test_results_of_the_placement_job_that_are_cut_off(finished, tmp_path):
    assert check_cut_off(finished, tmp_path) == {".parquet", ".json", ".tif", ".gpkg"}


def test_results_of_the_pole_job_that_are_cut_off(finished_road, tmp_path):
    expected = {".parquet", ".json", ".tif", ".gpkg", ".zip", ".npz"}
    assert check_cut_off(finished_road, tmp_path) == expected


def place_in_a_page(path, rng):
    """A byte that holds content: near the end of the largest column of a table, else anywhere.

    Headers of pages are outside the checksums of Parquet. None for a table without rows.
    """
    if path.suffix != ".parquet":
        return int(rng.integers(path.stat().st_size // 2))
    about = pq.ParquetFile(path).metadata
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    columns = [group.column(i) for group in groups for i in range(about.num_columns)]
    if not columns:
        return None
    largest = max(columns, key=lambda column: column.total_compressed_size)
    start = largest.dictionary_page_offset or largest.data_page_offset
    size = largest.total_compressed_size
    return start + size - 1 - int(rng.integers(max(size // 8, 1)))


def check_rotten(checkout, tmp_path, rng):
    """One flipped bit in the content of a table or shard of images gives no other numbers."""
    for path, read in intermediate_results(checkout):
        if path.suffix not in (".parquet", ".zip"):
            continue
        place = place_in_a_page(path, rng)
        if place is None:
            continue
        whole = repr(read(path))
        content = bytearray(path.read_bytes())
        content[place] ^= 1 << int(rng.integers(8))
        copy = tmp_path / path.relative_to(checkout.folder)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(content)
        try:
            found = repr(read(copy))
        except InputError as error:
            assert str(copy) in str(error), path
        else:
            assert found == whole, path


def test_a_flipped_bit_in_the_placement_job(finished, tmp_path, rng):
    check_rotten(finished, tmp_path, rng)


def test_a_flipped_bit_in_the_pole_job(finished_road, tmp_path, rng):
    check_rotten(finished_road, tmp_path, rng)


def test_a_cut_off_shard_stops_the_run_and_is_made_again(copy_of_finished):
    folder = copy_of_finished.folder
    expected = digests(folder)
    struck = Disturbed(copy_of_finished, np.random.default_rng(0))
    struck.forget("tiny/placement/round-0/coverage.json")
    shard = folder / "results/tiny/placement/round-0/detection/OS1-64/0.parquet"
    shard.write_bytes(shard.read_bytes()[:-1000])
    run = struck.start()
    assert run.end() != 0
    assert "round-0/detection/OS1-64/0.parquet: cannot be read" in run.text
    assert "delete it and run the workflow again" in run.text
    assert "Traceback" not in run.text
    shard.unlink()
    struck.finish()
    check_same(folder, expected)


def test_corrupt_caches(copy_of_finished):
    """Checksums that are no more are computed again; compiled kernels that are rotten are told."""
    cache = copy_of_finished.folder / ".snakemake/roadsight"
    (cache / "checksums.json").write_bytes(b'{"')
    assert copy_of_finished.stale_rules() == set()
    kernels = sorted(cache.rglob("*.nbi"))
    assert kernels
    for kernel in kernels:
        kernel.write_bytes(kernel.read_bytes()[:20])
    target = "results/tiny/scene/surfels.parquet"
    result = copy_of_finished.snakemake("--cores", "1", "--force", target)
    output = result.stdout + result.stderr
    assert result.returncode == 0 or "compiled kernels" in output, output[-4000:]
    assert "Traceback" not in output


def test_an_input_that_changes_between_two_runs(copy_of_finished):
    """Digitised edges of a user, changed after the run that read them."""
    folder = copy_of_finished.folder
    site = folder / "config/sites/tiny.yaml"
    edges = json.loads((folder / "results/tiny/sample/edges.geojson").read_text())
    own = folder / "config/sites/edges.geojson"
    own.write_text(json.dumps(edges))
    site.write_text(site.read_text().replace("edges: sample", "edges: edges.geojson"))
    target = "results/tiny/placement/edges.gpkg"
    assert copy_of_finished.snakemake("--cores", "1", target).returncode == 0
    assert copy_of_finished.stale_rules(target) == set()
    first = edges["features"][0]["geometry"]["coordinates"]
    edges["features"][0]["geometry"]["coordinates"] = np.add(first, 0.01).tolist()
    own.write_text(json.dumps(edges))
    assert copy_of_finished.stale_rules(target) == {"build_edges"}
    shutil.rmtree(folder / ".snakemake/log")
