import numpy as np
import pandas as pd
import pytest

from roadsight.placement.sight.detection import detection_matrix, times_seen

CHOICES = pd.MultiIndex.from_tuples(
    [("VLP-16", "a"), ("VLP-16", "b"), ("OS-128", "a")], names=["sensor", "candidate"]
)
TARGETS = pd.Index(["t1", "t2", "t3", "t4"])


def seen(*rows):
    return pd.DataFrame(rows, columns=["sensor", "candidate", "target"])


def test_rows_are_choices_and_columns_are_targets():
    detections = seen(("OS-128", "a", "t3"), ("VLP-16", "a", "t1"), ("VLP-16", "a", "t3"))
    matrix = detection_matrix(detections, CHOICES, TARGETS)
    assert matrix.dtype == bool
    assert matrix.toarray().astype(int).tolist() == [[1, 0, 1, 0], [0, 0, 0, 0], [0, 0, 1, 0]]


def test_the_same_candidate_with_another_sensor_is_another_choice():
    matrix = detection_matrix(seen(("OS-128", "a", "t2")), CHOICES, TARGETS)
    assert matrix[:, 1].toarray().ravel().tolist() == [False, False, True]


def test_what_no_choice_or_target_knows_is_left_out():
    """Detections of another plan's sensors and of excluded targets share the files."""
    detections = seen(("OS-32", "a", "t1"), ("VLP-16", "z", "t1"), ("VLP-16", "a", "t9"))
    assert detection_matrix(detections, CHOICES, TARGETS).nnz == 0


def test_repeated_detections_count_once():
    detections = seen(*[("VLP-16", "b", "t4")] * 3)
    matrix = detection_matrix(detections, CHOICES, TARGETS)
    assert matrix.toarray().sum() == 1
    assert matrix.nnz == 1
    assert times_seen(matrix, np.array([1])).tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("rows", [CHOICES, CHOICES[:0]])
@pytest.mark.parametrize("columns", [TARGETS, TARGETS[:0]])
def test_nothing_seen_is_an_empty_matrix_of_the_right_shape(rows, columns):
    matrix = detection_matrix(seen(), rows, columns)
    assert matrix.shape == (len(rows), len(columns))
    assert matrix.nnz == 0


def test_times_seen_counts_the_chosen_rows_only(rng):
    dense = rng.random((40, 25)) < 0.3
    row, column = np.nonzero(dense)
    choices = pd.MultiIndex.from_product([["s"], range(40)])
    detections = pd.DataFrame({"sensor": "s", "candidate": row, "target": column})
    matrix = detection_matrix(detections, choices, pd.Index(range(25)))
    chosen = np.array([0, 7, 8, 39])
    assert times_seen(matrix, chosen).tolist() == dense[chosen].sum(axis=0).tolist()
    assert times_seen(matrix, np.empty(0, np.int64)).tolist() == [0] * 25
