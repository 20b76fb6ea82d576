import cv2
import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.poles.images.kinds import PixelClass
from roadsight_training.augment import Crops, random_batch, with_camera_faults
from roadsight_training.measures import (
    affine_fit,
    confusion,
    correlation,
    marking_errors,
    match_poles,
    road_border_errors,
    scores_by_class,
)
from roadsight_training.pasted_panels import with_panels
from roadsight_training.samples import (
    DEPTH_SCALE,
    Sample,
    digest,
    read_samples,
    update_record,
    write_sample,
)

NEAR = np.ones((60, 80), bool)


def painted_sample(rng, shape=(96, 128)):
    """Sample whose colour and depth can be told from its classes."""
    blocks = rng.integers(0, 12, (shape[0] // 16, shape[1] // 16))
    classes = np.kron(blocks, np.ones((16, 16))).astype(np.uint8)
    colour = np.repeat((classes * 20)[..., None], 3, axis=2)
    return Sample(colour, classes, (classes.astype(np.uint16) + 1) * 1000)


def road_mask(left=20, right=60):
    mask = np.full((60, 80), PixelClass.VEGETATION, np.uint8)
    mask[20:, left:right] = PixelClass.ROAD
    return mask


def test_samples_come_back_as_written(tmp_path):
    rng = np.random.default_rng(0)
    samples = [painted_sample(rng) for _ in range(3)]
    for number, sample in enumerate(samples):
        write_sample(tmp_path, 1000 + number % 2, number, sample)
    found = list(read_samples(tmp_path, 1000, 2))
    assert [seed for seed, _ in found] == [1000, 1000, 1001]
    for (_, one), other in zip(found, (samples[0], samples[2], samples[1]), strict=True):
        for part in ("colour", "classes", "depth"):
            np.testing.assert_array_equal(getattr(one, part), getattr(other, part))
    assert digest(sample for _, sample in found) != digest(samples)
    assert digest(sample for _, sample in read_samples(tmp_path, 1001, 1)) == digest([samples[1]])


def test_missing_site_is_named(tmp_path):
    with pytest.raises(InputError, match="seed 1000"):
        list(read_samples(tmp_path, 1000, 1))


def test_crops_keep_colour_classes_and_depth_together():
    sample = painted_sample(np.random.default_rng(3))
    crops = Crops(64, 80, (0.6, 2.0), 0.5)
    for seed in range(8):
        batch = random_batch([sample], 2, crops, np.random.default_rng(seed))
        assert batch.images.shape == (2, 3, 64, 80)
        depth = batch.inverse_depth * DEPTH_SCALE / 1000.0
        np.testing.assert_allclose(depth, batch.classes + 1, rtol=1e-5)
        for grey, classes in zip(batch.images.mean(axis=1), batch.classes, strict=True):
            assert np.corrcoef(grey.ravel(), classes.ravel())[0, 1] > 0.9


def test_wanted_crops_hold_the_classes_that_are_wanted():
    sample = painted_sample(np.random.default_rng(3), (192, 256))
    sample.classes[sample.classes == PixelClass.SIGN] = PixelClass.ROAD
    sample.classes[40:44, 60:64] = PixelClass.SIGN
    crops = Crops(32, 32, (1.0, 1.0001), 1.0, (PixelClass.SIGN,))
    for seed in range(8):
        batch = random_batch([sample], 2, crops, np.random.default_rng(seed))
        assert (batch.classes == PixelClass.SIGN).any(axis=(1, 2)).all()


def test_crops_depend_on_the_generator_only():
    samples = [painted_sample(np.random.default_rng(i)) for i in range(4)]
    one, other, third = (
        random_batch(samples, 3, Crops(48, 64), np.random.default_rng(seed)) for seed in (7, 7, 8)
    )
    assert one.images.tobytes() == other.images.tobytes()
    assert one.images.tobytes() != third.images.tobytes()


def test_camera_faults_change_colours_but_stay_images():
    grey = np.full((40, 50, 3), 128, np.uint8)
    found = [with_camera_faults(grey, np.random.default_rng(seed)) for seed in range(20)]
    assert all(image.shape == grey.shape and image.dtype == np.uint8 for image in found)
    assert np.std([image.mean() for image in found]) > 5


def test_confusion_counts_every_pair():
    rng = np.random.default_rng(5)
    found, truth = rng.integers(0, 13, (2, 20, 30)).astype(np.uint8)
    slow = np.zeros((13, 13), int)
    for true, seen in zip(truth.ravel(), found.ravel(), strict=True):
        slow[true, seen] += 1
    np.testing.assert_array_equal(confusion(found, truth), slow)


def test_scores_of_a_half_found_road():
    truth, found = road_mask(), road_mask(20, 40)
    scores = scores_by_class(confusion(found, truth))
    assert scores["road"] == pytest.approx(
        {"iou": 0.5, "precision": 1.0, "recall": 0.5, "true_share": 1600 / 4800}
    )
    assert set(scores) == {"road", "vegetation"}


@pytest.mark.parametrize("shift", [0, 1, 3])
def test_border_error_is_the_shift_of_the_border(shift):
    errors = road_border_errors(road_mask(20 + shift, 60 + shift), road_mask(), NEAR)
    assert np.median(errors) == pytest.approx(shift)
    assert len(errors) > 100


def test_border_that_is_not_found_counts_as_far():
    errors = road_border_errors(np.zeros((60, 80), np.uint8), road_mask(), NEAR)
    assert (errors == 10.0).all()


def test_marking_errors_tell_shifted_missed_and_invented():
    truth, found = road_mask(), road_mask()
    truth[20:, 25:28] = found[20:, 26:29] = PixelClass.MARKING
    truth[30:40, 50:52] = PixelClass.MARKING
    found[50:55, 45:47] = PixelClass.MARKING
    errors, missed, invented = marking_errors(found, truth, NEAR)
    np.testing.assert_allclose(errors, 1.0)
    assert (len(errors), missed, invented) == (40, 10, 5)


def test_poles_are_matched_by_their_axis():
    truth = np.full((400, 300), PixelClass.SKY, np.uint8)
    found = truth.copy()
    truth[100:300, 50:56] = found[102:298, 51:57] = PixelClass.POLE
    truth[100:300, 150:156] = found[100:300, 250:256] = PixelClass.POLE
    depth_m = np.full(truth.shape, np.inf)
    depth_m[truth == PixelClass.POLE] = 30.0
    matches = match_poles(found, truth, depth_m)
    np.testing.assert_array_equal(matches.hit, [True, False])
    np.testing.assert_allclose(matches.true_m, 30.0)
    np.testing.assert_allclose(matches.foot_px[0], [1.0, -2.0], atol=0.2)
    assert np.isinf(matches.false_m).tolist() == [True]


def test_affine_fit_and_correlation_undo_scale_and_offset():
    truth = np.random.default_rng(2).random(50)
    scale, offset = affine_fit(4.0 * truth - 3.0, truth)
    assert (scale, offset) == pytest.approx((0.25, 0.75))
    assert correlation(4.0 * truth - 3.0, truth) == pytest.approx(1.0)
    assert np.isnan(correlation(truth, np.ones(50)))


def test_record_keeps_what_others_wrote(tmp_path):
    path = tmp_path / "record.json"
    update_record(path, "a.onnx", {"seed": 1})
    update_record(path, "b.onnx", {"seed": 2})
    update_record(path, "a.onnx", {"steps": 3})
    assert path.read_text().count("seed") == 2
    assert '"steps": 3' in path.read_text()


class TestTraining:
    """What needs PyTorch."""

    @pytest.fixture(autouse=True)
    def torch(self):
        self.torch = pytest.importorskip("torch")

    def trained(self, kind):
        from dataclasses import replace

        from roadsight_training.train_networks import TASKS, Schedule, train

        self.torch.set_num_threads(1)
        samples = [painted_sample(np.random.default_rng(i)) for i in range(2)]
        task = replace(TASKS[kind], crops=Crops(64, 80))
        losses = []
        schedule = Schedule(steps=2, batch=2)
        return train(task, samples, schedule, lambda _, loss, __: losses.append(loss)), losses

    @pytest.mark.parametrize("kind", ["classes", "depth"])
    def test_two_runs_give_the_same_file(self, kind, tmp_path):
        pytest.importorskip("onnx")
        from roadsight_training.export import export_network

        files = []
        for name in ("one.onnx", "other.onnx"):
            network, losses = self.trained(kind)
            assert np.isfinite(losses).all()
            assert export_network(network, tmp_path / name, "output") < 1e-4
            files.append((tmp_path / name).read_bytes())
        assert files[0] == files[1]

    @pytest.mark.parametrize("kind", ["classes", "depth"])
    def test_training_can_go_on_from_a_file(self, kind, tmp_path):
        pytest.importorskip("onnx")
        from roadsight_training.export import export_network, start_from
        from roadsight_training.networks import seeded

        network, _ = self.trained(kind)
        export_network(network, tmp_path / "first.onnx", "output")
        other = seeded(type(network), 5)
        images = self.torch.rand(2, 3, 64, 80)
        start_from(other, tmp_path / "first.onnx", images)
        with self.torch.no_grad():
            expected, found = (one.eval()(images) for one in (network, other))
            np.testing.assert_allclose(found, expected, atol=1e-4 * float(expected.abs().max()))

    def test_depth_loss_knows_no_scale_nor_offset(self):
        from roadsight_training.losses import depth_loss, normalised

        truth = self.torch.rand(2, 32, 32, generator=self.torch.Generator().manual_seed(1))
        classes = self.torch.zeros(2, 32, 32, dtype=self.torch.long)
        best = depth_loss(normalised(truth), truth, classes)
        assert float(best) < 1e-5
        scaled = depth_loss(normalised(truth), 7.0 * truth + 2.0, classes)
        assert float(scaled) == pytest.approx(float(best), abs=1e-4)
        assert float(depth_loss(-truth, truth, classes)) > 1.0

    def test_classes_loss_falls_with_the_right_answer(self):
        from roadsight_training.losses import classes_loss

        classes = self.torch.randint(0, 13, (2, 16, 16))
        right = self.torch.nn.functional.one_hot(classes, 13).permute(0, 3, 1, 2).float()
        assert float(classes_loss(9.0 * right, classes)) < float(classes_loss(right, classes))
        assert float(classes_loss(20.0 * right, classes)) < 0.01


def test_drawn_signs_stand_on_grass_and_change_nothing_else():
    classes = np.full((96, 128), PixelClass.TREE, np.uint8)
    classes[60:] = PixelClass.VEGETATION
    colour = np.full((96, 128, 3), 90, np.uint8)
    found, kinds = with_panels(colour, classes, 6.0, np.random.default_rng(4))
    again = with_panels(colour, classes, 6.0, np.random.default_rng(4))
    np.testing.assert_array_equal(found, again[0])
    drawn = kinds != classes
    assert set(np.unique(kinds[drawn])) == {PixelClass.SIGN, PixelClass.POLE}
    assert np.count_nonzero(kinds == PixelClass.SIGN) > 50
    far = cv2.dilate(drawn.astype(np.uint8), np.ones((5, 5))) == 0
    np.testing.assert_array_equal(found[far], colour[far])


def test_no_sign_is_drawn_where_nothing_can_stand():
    classes = np.full((96, 128), PixelClass.ROAD, np.uint8)
    _, kinds = with_panels(np.zeros((96, 128, 3), np.uint8), classes, 6.0, np.random.default_rng(4))
    np.testing.assert_array_equal(kinds, classes)


def test_pixels_of_small_signs_count_more():
    pytest.importorskip("torch")
    from roadsight_training.losses import sign_weights

    classes = np.zeros((1, 64, 64), np.int64)
    classes[0, :5, :5] = classes[0, 20:60, 20:60] = PixelClass.SIGN
    weights = sign_weights(classes)
    assert weights[0, 2, 2] == pytest.approx(4.0)
    assert weights[0, 40, 40] == weights[0, 10, 10] == 1.0
