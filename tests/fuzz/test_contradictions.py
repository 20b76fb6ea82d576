"""Files that contradict themselves give the answer of the clean file, a note, or one message."""

import logging
import os

import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.io.cloud.clouds import read_header, read_laz
from roadsight.io.records.text_tables import read_sightings
from tests.fuzz.contradictions import KINDS, clean_cloud, contradicted_cloud, table
from tests.fuzz.image_contradictions import check_image
from tests.fuzz.vector_contradictions import check_vector
from tests.fuzz.videolog_contradictions import check_videolog

FEW, SOME, MANY = 8, 200, int(os.environ.get("ROADSIGHT_FUZZ", "500"))
"""Files of each kind, the same in every run; more with ROADSIGHT_FUZZ=10000."""
CHECKS = {"image": check_image, "videolog": check_videolog, "vector": check_vector}
"""What compares one generated file, by its number, with the clean answer."""


def compare_clouds(folder, kind, numbers):
    for number in numbers:
        rng = np.random.default_rng(number)
        path, code = clean_cloud(folder / "a.las", rng)
        clean = read_laz(path).xyz
        point_format = path.read_bytes()[104]
        contradicted_cloud(path, kind, rng)
        header = read_header(path)
        np.testing.assert_array_equal(read_laz(path).xyz, clean)
        told = [header.stated.problem, *header.stated.notes, *header.notes]
        if kind == "stale keys, no bit":
            found = None if header.stated.crs is None else header.stated.crs.to_epsg()
            assert (found is None) == (point_format == 6)
            assert found != code
        else:
            assert header.stated.crs.to_epsg() == code
        assert any(told) == (kind != "one part"), (number, kind)


def compare_tables(folder, numbers):
    for number in numbers:
        clean, written = table(np.random.default_rng(number))
        (folder / "clean.csv").write_text(clean)
        (folder / "other.csv").write_bytes(written)
        pd.testing.assert_frame_equal(
            read_sightings(folder / "other.csv"), read_sightings(folder / "clean.csv")
        )


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_clouds(tmp_path, kind):
    compare_clouds(tmp_path, kind, range(FEW))


def test_some_tables(tmp_path):
    compare_tables(tmp_path, range(60))


@pytest.mark.parametrize("reader", CHECKS)
def test_some_files_of_each_reader(tmp_path, reader):
    for number in range(SOME):
        CHECKS[reader](tmp_path, number)


@pytest.mark.full
@pytest.mark.parametrize("reader", CHECKS)
def test_many_files_of_each_reader(tmp_path, reader):
    logging.disable(logging.WARNING)  # a line for each drive against its measure
    try:
        for number in range(MANY):
            CHECKS[reader](tmp_path, number)
    finally:
        logging.disable(logging.NOTSET)


def test_keys_of_a_table_are_not_guessed(tmp_path):
    (tmp_path / "a.csv").write_text("lat,lon,bearing\n1,2,3,4\n")
    with pytest.raises(InputError, match="more cells"):
        read_sightings(tmp_path / "a.csv")


@pytest.mark.full
@pytest.mark.parametrize("kind", KINDS)
def test_many_clouds(tmp_path, kind):
    compare_clouds(tmp_path, kind, range(MANY))


@pytest.mark.full
def test_many_tables(tmp_path):
    compare_tables(tmp_path, range(MANY))
