import argparse

import numpy as np
import pandas as pd

from roadsight.base.options import add_options, called
from roadsight.io.images.image_shards import ImageShardWriter
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.images.kinds import PixelClass
from roadsight.stages.poles import trace_pole_axes
from roadsight.stages.poles.shared.alignment_inputs import SceneFiles, read_columns


def test_axes_of_all_views_are_traced(tmp_path):
    frames = pd.DataFrame(
        {"image": ["a.jpg", "b.jpg"], "path": ["a.jpg", "b.jpg"], "left_path": ["l.jpg", ""],
         "right_path": "", "status": ["ok", "no position"]}
    )  # fmt: skip
    write_table(tmp_path / "frames.parquet", frames)
    mask = np.full((600, 1000), PixelClass.VEGETATION, np.uint8)
    mask[400:] = PixelClass.ROAD
    mask[100:450, 300:310] = PixelClass.POLE
    with ImageShardWriter(tmp_path / "masks.zip") as shard:
        shard.write("a", mask)
        shard.write("a.left", np.zeros_like(mask))
    out = tmp_path / "axes.parquet"
    files = "--frames", str(tmp_path / "frames.parquet"), "--masks", str(tmp_path / "masks.zip")
    assert trace_pole_axes.main([*files, "--out", str(out)]) == 0
    (row,) = read_table(out).to_dict("records")
    assert (row["image"], row["view"], row["foot_visible"], row["top_cut"]) == (
        "a.jpg",
        "front",
        True,
        False,
    )
    assert abs(row["u"] - 304.5) < 0.1 and abs(row["v"] - 274.5) < 1.0
    assert (row["v_foot"], row["v_top"]) == (449.5, 99.5)
    assert (row["width_view_px"], row["height_view_px"]) == (1000, 600)
    assert trace_pole_axes.main([*files, "--shard", "5", "--shards", "64", "--out", str(out)]) == 0
    assert list(read_table(out).columns) == list(row)


def test_options_may_come_without_a_value():
    parser = argparse.ArgumentParser()
    add_options(parser, SceneFiles)
    words = "--frames f --road-edges r --frame j --image-edges e --terrain --dem"
    given = called(SceneFiles, parser.parse_args([*words.split(), "--pole-axes", "--columns"]))
    assert given.pole_axes == () and given.columns is None and given.terrain is None
    assert len(read_columns(None)) == 0
