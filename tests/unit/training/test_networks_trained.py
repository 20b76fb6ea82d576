from functools import cache

import numpy as np
import pytest

from roadsight.base.texts import read_yaml
from roadsight.io.images.models import open_model
from roadsight.io.records.sources import sha256
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.networks import (
    class_mask,
    downward_trend,
    inverse_depth,
    packed_depth,
    tensor_of,
)
from roadsight_worlds.rendering.rendering_look import random_training_views
from tests.conftest import PROJECT

RESOURCES = PROJECT / "resources"
HELD_OUT_SEED = 912


@cache
def held_out_view():
    return next(random_training_views(HELD_OUT_SEED, 1, 640, 416, 200.0))


@cache
def shipped(name):
    return open_model(RESOURCES / "manifests" / f"{name}.yaml")


def run(name, image):
    model = shipped(name)
    tensor = tensor_of(image, model.manifest.input)
    return model.session.run(list(model.output_names), {model.input_name: tensor})


def overlap(found, truth):
    return np.count_nonzero(found & truth) / np.count_nonzero(found | truth)


def found_mask():
    view = held_out_view()
    outputs = run("road_classes", view.colour)
    return class_mask(outputs, shipped("road_classes").manifest, view.classes.shape, "")


def test_road_and_poles_of_a_held_out_road_are_found():
    truth, found = held_out_view().classes, found_mask()
    assert np.count_nonzero(truth == PixelClass.POLE) > 200
    paved = (PixelClass.ROAD, PixelClass.MARKING)
    assert overlap(np.isin(found, paved), np.isin(truth, paved)) > 0.8
    assert overlap(found == PixelClass.POLE, truth == PixelClass.POLE) > 0.4
    assert overlap(found == PixelClass.SKY, truth == PixelClass.SKY) > 0.6


def test_a_mirrored_road_has_a_mirrored_mask():
    view = held_out_view()
    outputs = run("road_classes", np.ascontiguousarray(view.colour[:, ::-1]))
    mask = class_mask(outputs, shipped("road_classes").manifest, view.classes.shape, "")
    assert np.mean(mask[:, ::-1] == found_mask()) > 0.9


def test_depth_rises_downwards_and_follows_the_road():
    view = held_out_view()
    model = shipped("road_depth")
    found = inverse_depth(run("road_depth", view.colour), model.manifest)
    packed = packed_depth(found, metric=False)
    assert downward_trend(packed) > 0.8
    rows = (np.arange(416) * found.shape[0]) // 416
    columns = (np.arange(640) * found.shape[1]) // 640
    road = (view.classes == PixelClass.ROAD) & (view.depth_m < 60.0)
    same_size = found[np.ix_(rows, columns)]
    assert np.corrcoef(same_size[road], 1.0 / view.depth_m[road])[0, 1] > 0.9


@pytest.mark.parametrize("shape", [(64, 96), (80, 64), (208, 320)])
@pytest.mark.parametrize(("name", "channels"), [("road_classes", 13), ("road_depth", 1)])
def test_output_has_the_size_of_the_input(name, channels, shape):
    model = shipped(name)
    images = np.random.default_rng(0).random((2, 3, *shape), np.float32)
    (output,) = model.session.run(list(model.output_names), {model.input_name: images})
    assert output.shape == (2, channels, *shape)
    assert output.dtype == np.float32
    assert np.isfinite(output).all()


@pytest.mark.parametrize("name", ["road_classes", "road_depth"])
def test_any_number_of_threads_gives_the_same_bytes(name):
    images = np.random.default_rng(1).random((1, 3, 128, 160), np.float32)
    outputs = []
    for threads in (1, 1, 2):
        model = open_model(RESOURCES / "manifests" / f"{name}.yaml", threads)
        outputs += model.session.run(list(model.output_names), {model.input_name: images})
    assert outputs[0].tobytes() == outputs[1].tobytes() == outputs[2].tobytes()


@pytest.mark.parametrize("name", ["road_classes.onnx", "road_depth.onnx"])
def test_files_are_small_and_those_of_the_record(name):
    path = RESOURCES / "models" / name
    assert path.stat().st_size < 2_000_000
    record = read_yaml(RESOURCES / "models" / "training_record.json")
    assert record[name]["sha256"] == sha256(path)
    assert record[name]["data"]["first_seed"] >= 1000
    assert b"/" + b"work/" not in path.read_bytes()
