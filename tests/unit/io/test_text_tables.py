import numpy as np
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.config.sites import Site
from roadsight.config.starter import site_text
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.text_tables import read_cells, read_sightings

PLAIN = "lat,lon,bearing,depth,image\n35.7,-78.6,78.69,30.5,a\n35.8,-78.5,8.6,,b\n"


def with_commas(text):
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "content",
    [
        PLAIN,
        PLAIN.replace("\n3", ",\n3").replace("b\n", "b,\n").replace("image,\n", "image\n"),
        PLAIN.replace("\n", ",,,\n"),
        PLAIN.replace("\n", "\r\n"),
        "\ufeff" + PLAIN,
        PLAIN.replace(",", "\t"),
        with_commas(PLAIN),
        with_commas(PLAIN).replace(";", "\t"),
        "sep=;\n" + with_commas(PLAIN),
        PLAIN + "\n\n,,,,\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_all_say_the_same(tmp_path, content, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes(content.encode(encoding))
    found = read_sightings(path)
    np.testing.assert_allclose(found[["lat", "lon"]], [[35.7, -78.6], [35.8, -78.5]])
    np.testing.assert_allclose(found["depth"], [30.5, np.nan])
    assert found["image"].tolist() == ["a", "b"]


def test_cells_beyond_the_header_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text(PLAIN.replace("30.5,a", "30,5,a"))
    with pytest.raises(InputError, match=r"line 2.*more cells than the header.*6 cells"):
        read_cells(tmp_path / "a.csv")


def test_table_of_the_cases(cases):
    folder = cases / "07-trailing-comma-csv"
    right, found = (read_sightings(folder / f"{name}.csv") for name in ("right", "sightings"))
    np.testing.assert_array_equal(found.to_numpy(), right.to_numpy())


NAMES = ["171500_202500", "20240501", "2024-05-01", "0123", "no", "null", "yes", "on", "1e3"]


@pytest.mark.parametrize("name", NAMES)
def test_init_writes_names_that_yaml_would_misread_in_quotes(name):
    content = yaml.safe_load(site_text(name, ["a.laz"], [], {}))
    assert validated(Site, content, "a.yaml").site == name


@pytest.mark.parametrize("name", NAMES[:-1])
def test_the_message_says_quotes(name):
    content = yaml.safe_load(f"site: {name}\nclouds: [a.laz]")
    with pytest.raises(InputError, match="put it in quotes"):
        validated(Site, content, "a.yaml")


@pytest.mark.parametrize(
    "name",
    [
        r"C:\data\run 2\p.jpg",
        "C:\\\\data\\\\run 2\\\\p.jpg",
        "/data/run 2/p.jpg",
        r"\\nas\run 2\p.jpg",
    ],
)
def test_paths_of_the_recording_computer(tmp_path, name):
    for run in ("run 1", "run 2"):
        (tmp_path / run).mkdir()
        (tmp_path / run / "p.jpg").write_bytes(b"x")
    assert ImageSource(tmp_path).find(name) == "run 2/p.jpg"
    assert ImageSource(tmp_path / "run 1").find(name) == "p.jpg"
