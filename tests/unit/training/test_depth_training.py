import json

import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.records.depth_maps import (
    STEP_M,
    DepthPairs,
    digest,
    read_dataset,
    read_pairs,
    stack_pairs,
    stepped,
    write_pairs,
)
from roadsight.io.records.tables import write_table
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.unet import RANGES_M, training_sensor
from roadsight.stages.placement import render_depth_pairs
from roadsight_training import render_depth_dataset
from roadsight_training.depth_patches import PATCH_CELLS, random_patches
from roadsight_training.depth_scenes import highway_site, simple_site
from roadsight_training.evaluate_depth_network import map_errors, pixel_errors


def random_pairs(seed, maps=3, shape=(80, 120)):
    rng = np.random.default_rng(seed)
    refined = rng.integers(1, 20_000, (maps, *shape)).astype(np.uint16)
    refined[:, 40:] = 0
    preliminary = np.where(rng.random(refined.shape) < 0.3, refined, 0).astype(np.uint16)
    return DepthPairs(preliminary, refined)


class TestPairs:
    def test_they_come_back_as_written_and_repeat_their_bytes(self, tmp_path):
        pairs = random_pairs(1)
        for name in ("a", "b"):
            write_pairs(tmp_path / f"{name}.exact.npz", pairs)
        assert (tmp_path / "a.exact.npz").read_bytes() == (tmp_path / "b.exact.npz").read_bytes()
        found = read_dataset(tmp_path, "exact")
        assert list(found) == ["a", "b"]
        np.testing.assert_array_equal(found["a"].preliminary, pairs.preliminary)
        np.testing.assert_array_equal(found["a"].refined, pairs.refined)
        assert digest(found.values()) == digest([pairs, pairs]) != digest([pairs])

    def test_steps_keep_ranges_and_returns(self):
        range_m = np.array([0.0, 0.0005, 1.0, 199.999, 400.0])
        steps = stepped(range_m)
        assert steps.tolist()[:2] == [0, 1]
        np.testing.assert_allclose(steps[2:4] * STEP_M, range_m[2:4], atol=STEP_M)
        assert steps[4] == 65535

    def test_what_is_wrong_is_told(self, tmp_path):
        with pytest.raises(InputError, match="no pairs with the truth 'hybrid'"):
            read_dataset(tmp_path, "hybrid")
        (tmp_path / "x.exact.npz").write_bytes(b"PK nothing")
        with pytest.raises(InputError, match="holds no pairs of depth maps"):
            read_pairs(tmp_path / "x.exact.npz")
        maps = np.zeros((1, 3, 4), np.uint16)
        write_pairs(tmp_path / "y.exact.npz", DepthPairs(maps, maps[:, :2]))
        with pytest.raises(InputError, match="differ in size"):
            read_pairs(tmp_path / "y.exact.npz")


class TestPatches:
    def test_they_are_cut_from_the_maps_and_normalised(self):
        pairs = random_pairs(2, maps=1)
        patches = random_patches([pairs], 6, np.random.default_rng(3))
        assert patches.preliminary.shape == (6, 1, PATCH_CELLS, PATCH_CELLS)
        assert patches.preliminary.min() >= 0 and patches.preliminary.max() <= 1
        np.testing.assert_allclose(patches.scale_m, pairs.preliminary.max() * STEP_M)
        known = patches.preliminary > 0
        np.testing.assert_array_equal(patches.preliminary[known], patches.refined[known])
        steps = np.rint(patches.refined * patches.scale_m / STEP_M)
        assert np.isin(steps, pairs.refined).all()

    def test_they_depend_on_the_generator_only(self):
        dataset = [random_pairs(seed) for seed in (1, 2)]
        one, other, third = (
            random_patches(dataset, 4, np.random.default_rng(seed)) for seed in (5, 5, 6)
        )
        assert all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))
        assert one.refined.tobytes() != third.refined.tobytes()

    def test_maps_without_any_return_give_empty_patches(self):
        nothing = np.zeros((1, 60, 60), np.uint16)
        patches = random_patches([DepthPairs(nothing, nothing)], 2, np.random.default_rng(0))
        assert not patches.preliminary.any()
        assert np.isfinite(patches.scale_m).all()


class TestScenes:
    def test_sensors_are_those_of_the_paper(self):
        rng = np.random.default_rng(0)
        for _ in range(20):
            sensor = training_sensor(rng, 90.0)
            assert sensor.shape == (500, 900)
            assert sensor.range_m in RANGES_M
            assert -180 <= sensor.azimuth_min_deg < sensor.azimuth_max_deg <= 180 + 1e-9
            np.testing.assert_allclose(sensor.elevation_edges_deg[[0, -1]], [-25, 25], atol=1e-9)

    @pytest.mark.parametrize("make", [highway_site, simple_site])
    def test_clouds_lie_on_the_exact_surfaces(self, make):
        site = make(41, 2)
        sensor = training_sensor(np.random.default_rng(1), 20.0)
        exact = site.exact(sensor, 0)
        seen = site.cloud_m, sensor, site.positions_m[0], float(site.yaws_deg[0])
        found = preliminary_depth(*seen)
        both = (found > 0) & (exact > 0)
        assert both.mean() > 0.03
        assert np.median(np.abs(found - exact)[both]) < 0.1

    def test_the_dataset_repeats_itself(self, tmp_path):
        for name in ("a", "b"):
            arguments = ["--first-seed", "50", "--highways", "0", "--simple", "1", "--poses", "1"]
            out = ["--out", str(tmp_path / name), "--span-deg", "6"]
            assert render_depth_dataset.main([*arguments, *out]) == 0
        for truth in render_depth_dataset.TRUTHS:
            one, other = (read_dataset(tmp_path / name, truth) for name in ("a", "b"))
            assert list(one) == ["simple_50"]
            assert digest(one.values()) == digest(other.values())


def test_errors_of_pixels_are_over_all_cells():
    steps = np.array([[[0, 1000, 2000, 0]]], np.uint16)
    wanted = np.array([[[0, 1000, 2500, 500]]], np.uint16)

    def kept(maps):
        return maps  # a regression that gives what it gets

    found = pixel_errors([DepthPairs(steps, wanted)], kept)
    off_m = STEP_M * np.array([0, 0, 500, 500])
    assert found["pixel_rmse_m"] == pytest.approx(np.sqrt(np.mean(off_m**2)), abs=1e-3)
    assert found["pixel_rmse"] == pytest.approx(found["pixel_rmse_m"] / (2000 * STEP_M), abs=1e-3)


def test_errors_of_maps_count_what_is_missed_invented_and_off():
    exact = np.array([[10.0, 10.0, 10.0, 0.0, 0.0]], np.float32)
    found = np.array([[10.4, 13.0, 0.0, 5.0, 0.0]], np.float32)
    errors = map_errors(found, exact)
    assert errors["wrong"] == pytest.approx(0.6)
    assert errors["missed"] == errors["invented"] == pytest.approx(0.2)
    assert errors["rmse_m"] == pytest.approx(np.sqrt((0.4**2 + 3.0**2) / 2))
    assert map_errors(found * 0, found * 0)["rmse_m"] == 0.0


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    rng = np.random.default_rng(4)
    road = rng.uniform([-20, -20, 0], [20, 20, 0.01], (30_000, 3))
    ones = np.ones(len(road), np.uint8)
    with TileWriter(folder / "cloud.parquet", 20.0, coloured=False) as writer:
        counts = dict.fromkeys(("classification", "return_number", "number_of_returns"), ones)
        columns = dict(zip("xyz", road.T, strict=True))
        writer.append(columns | {"intensity": ones} | counts)
        writer.finish()
    candidates = {"candidate": ["a", "b"], "x": [0.0, 4.0], "y": 1.0, "z": 6.0}
    table = pd.DataFrame(candidates | {"ground_z_m": 0.0, "yaw_deg": 30.0})
    write_table(folder / "candidates.parquet", table)
    write_table(folder / "none.parquet", table.iloc[:0])
    return folder


class TestStage:
    def run(self, site, out, candidates="candidates"):
        return render_depth_pairs.main(
            [
                *("--candidates", str(site / f"{candidates}.parquet")),
                *("--cloud", str(site / "cloud.parquet"), "--pairs", "3", "--span-deg", "12"),
                *("--out", str(site / out)),
            ]
        )

    def test_pairs_are_the_paper_s(self, site):
        assert self.run(site, "a.hybrid.npz") == 0
        assert self.run(site, "b.hybrid.npz") == 0
        assert (site / "a.hybrid.npz").read_bytes() == (site / "b.hybrid.npz").read_bytes()
        pairs = read_pairs(site / "a.hybrid.npz")
        assert pairs.refined.shape == (3, 500, 120)
        filled, given = pairs.refined > 0, pairs.preliminary > 0
        assert filled.sum() > 1.5 * given.sum() > 0
        assert filled[given].all()

    def test_no_candidate_is_told(self, site, capsys):
        assert self.run(site, "c.hybrid.npz", "none") == 2
        assert "has no candidate to stand at" in capsys.readouterr().err

    def test_pairs_of_maps_are_stacked(self):
        site = simple_site(3, 1)
        sensor = training_sensor(np.random.default_rng(0), 5.0)
        seen = site.cloud_m, sensor, site.positions_m[0], 0.0
        pairs = stack_pairs([(preliminary_depth(*seen), hybrid_depth(*seen))] * 2)
        assert len(pairs) == 2
        assert pairs.refined.shape == (2, 500, 50)


def least_and_sums(cells):
    """Least range of a few cells, 0 if none returns; sums of their ranges and returns, by cell."""
    some = cells[cells > 0]
    return (some.min() if some.size else 0.0), cells.sum() / cells.size, some.size / cells.size


def blended(blocks, row, column, size):
    """A map of blocks of a size at the middle of a cell: bilinear, constant beyond the middles."""
    value = 0.0
    y, x = (row + 0.5) / size - 0.5, (column + 0.5) / size - 0.5
    for i in range(blocks.shape[0] + 2):
        for j in range(blocks.shape[1] + 2):
            share = max(0.0, 1 - abs(y - (i - 1))) * max(0.0, 1 - abs(x - (j - 1)))
            inside = np.clip((i - 1, j - 1), 0, np.array(blocks.shape) - 1)
            value += share * blocks[tuple(inside)]
    return value


def slow_candidates(depth):
    """All nine candidates of each cell: its own range, 3 x 3 cells, blocks of 2, 4 and 8 cells."""
    rows, columns = depth.shape
    found = np.zeros((9, rows, columns))
    for row, column in np.ndindex(rows, columns):
        around = np.zeros((3, 3))  # beyond the map nothing returns
        for i, j in np.ndindex(3, 3):
            y, x = row + i - 1, column + j - 1
            if 0 <= y < rows and 0 <= x < columns:
                around[i, j] = depth[y, x]
        least, total, count = least_and_sums(around)
        found[:3, row, column] = depth[row, column], least, total / count if count else 0.0
    for level, size in enumerate((2, 4, 8)):
        blocks = np.zeros((3, rows // size, columns // size))
        for i, j in np.ndindex(*blocks.shape[1:]):
            cells = depth[i * size : (i + 1) * size, j * size : (j + 1) * size]
            blocks[:, i, j] = least_and_sums(cells)
        for row, column in np.ndindex(rows, columns):
            total, count = (blended(part, row, column, size) for part in blocks[1:])
            mean = total / count if count > 1e-3 else 0.0
            found[3 + 2 * level :][:2, row, column] = blocks[0, row // size, column // size], mean
    return found


class TestTraining:
    """These need the optional packages of training."""

    @pytest.fixture(autouse=True)
    def torch(self):
        self.torch = pytest.importorskip("torch")

    def trained(self, steps=8):
        from roadsight_training.depth_network import DepthUnet
        from roadsight_training.train_depth_network import Schedule, train

        self.torch.set_num_threads(1)
        losses = []
        network = train(
            [random_pairs(1), random_pairs(2)],
            Schedule(steps, 4),
            lambda: DepthUnet((8, 12, 16)),
            lambda step, loss, kept: losses.append(loss),
        )
        return network, losses

    def test_it_repeats_itself_and_the_file_gives_what_the_network_gives(self, tmp_path):
        from roadsight_training.export import export_network

        files = []
        for name in ("a", "b"):
            network, losses = self.trained()
            files.append(tmp_path / f"{name}.onnx")
            facts = {"kind": "depth_refinement", "step_deg": "0.1", "multiple_cells": "8"}
            worst = export_network(network, files[-1], "refined", "depth", channels=1, facts=facts)
            assert worst < 1e-4
            assert np.isfinite(losses).all()
        assert files[0].read_bytes() == files[1].read_bytes()

    def test_the_published_network_has_33_layers(self):
        from roadsight_training.published_unet import PublishedUnet, layers_of, regression_loss

        network = PublishedUnet(4).eval()
        assert layers_of(network) == 33
        maps = self.torch.rand(2, 1, 24, 36)
        found = network(maps)
        assert found.shape == maps.shape
        # A far change reaches no cell: two poolings see 22 cells around at most.
        other = maps.clone()
        other[..., 35] += 5.0
        assert self.torch.equal(network(other)[..., :12], found[..., :12])
        assert not self.torch.equal(network(other)[..., 30:], found[..., 30:])
        loss = regression_loss(found, maps)
        expected = 0.5 * np.mean((found.detach().numpy() - maps.numpy()) ** 2)
        assert float(loss.detach()) == pytest.approx(expected, rel=1e-5)

    def test_pairs_are_split_as_published(self):
        from roadsight_training.published_unet import split_pairs

        scenes = [random_pairs(1, maps=12), random_pairs(2, maps=8)]
        parts = split_pairs(scenes, 3)
        assert [sum(map(len, part)) for part in parts] == [14, 3, 3]
        marks = [pairs.refined[k].tobytes() for pairs in scenes for k in range(len(pairs))]
        drawn = [p.refined[k].tobytes() for part in parts for p in part for k in range(len(p))]
        assert sorted(drawn) == sorted(marks)
        again = split_pairs(scenes, 3)
        assert all(digest(a) == digest(b) for a, b in zip(parts, again, strict=True))
        assert digest(split_pairs(scenes, 4)[0]) != digest(parts[0])

    def test_too_few_pairs_to_test_by_are_refused(self):
        """Else the error on no pairs would be recorded as 0."""
        from roadsight_training.published_unet import split_pairs

        with pytest.raises(InputError, match="3 pairs"):
            split_pairs([random_pairs(1, maps=3)], 3)

    def test_the_command_trains_and_tests_the_published_network(self, tmp_path):
        from roadsight_training import train_depth_network

        write_pairs(tmp_path / "s.hybrid.npz", random_pairs(1, maps=8))
        files = ["--data", str(tmp_path), "--truth", "hybrid", "--shape", "published"]
        for name in ("a.onnx", "b.onnx"):
            options = ["--steps", "3", "--batch", "2", "--filters", "4"]
            assert train_depth_network.main([*files, *options, "--out", str(tmp_path / name)]) == 0
        assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()
        entry = json.loads((tmp_path / "training_record.json").read_text())["a.onnx"]
        assert (entry["layers"], entry["maps_of_parts"]) == (33, [6, 1, 1])
        assert entry["test"]["patch_rmse"] == pytest.approx(
            56 * entry["test"]["pixel_rmse"], abs=1e-3
        )

    def test_the_command_writes_file_and_record(self, tmp_path):
        from roadsight_training import train_depth_network

        write_pairs(tmp_path / "s.exact.npz", random_pairs(1))
        out = tmp_path / "out.onnx"
        options = ["--steps", "3", "--batch", "2", "--widths", "8", "8", "8"]
        out_options = ["--data", str(tmp_path), "--out", str(out)]
        assert train_depth_network.main([*out_options, *options]) == 0
        entry = json.loads((tmp_path / "training_record.json").read_text())["out.onnx"]
        assert entry["bytes"] == out.stat().st_size
        assert entry["data"]["scenes"] == ["s"]
        assert entry["largest_difference_onnx_torch"] < 1e-4
        assert train_depth_network.main([*out_options, "--steps", "0"]) == 2

    def test_candidates_are_what_lies_around(self):
        from roadsight_training.depth_network import candidates

        depth = self.torch.zeros(1, 1, 16, 16)
        depth[..., 4, 4], depth[..., 4, 5] = 0.5, 0.25
        found = candidates(depth, (depth > 0).float())[0].numpy()
        assert found[:4, 4, 4] == pytest.approx([0.5, 0.25, 0.375, 0.25])
        assert found[5, 7, 7] == pytest.approx(0.25)
        assert (found[0] > 0).sum() == 2
        assert not candidates(depth * 0, depth * 0).any()

    def test_candidates_are_those_of_a_slow_reference(self, rng):
        from roadsight_training.depth_network import candidates

        depth = np.where(rng.random((16, 24)) < 0.1, rng.uniform(0.1, 1.0, (16, 24)), 0.0)
        depth[:8, :8] = 0.0
        given = self.torch.tensor(depth, dtype=self.torch.float32)[None, None]
        found = candidates(given, (given > 0).float())[0].numpy()
        np.testing.assert_allclose(found, slow_candidates(depth), atol=1e-5)
