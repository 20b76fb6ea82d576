import argparse

import numpy as np
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.commands import init
from roadsight.config import starter
from roadsight.config.load import load_site
from roadsight.config.plans import load_plans
from roadsight.config.schema import Config
from roadsight.config.sites import Site
from tests.conftest import PROJECT
from tests.helpers.las_files import DATA, needs_data, random_points, wkt_of, write_las

UTM = wkt_of("EPSG:25832")


def run(*arguments):
    parser = argparse.ArgumentParser()
    init.VERB.add_to(parser.add_subparsers())
    parsed = parser.parse_args(["init", *map(str, arguments)])
    parsed.run(parsed)


def written(path):
    """Text of a site file, and its content as the workflow will read it."""
    text = path.read_text()
    content = yaml.safe_load(text)
    validated(Site, content, str(path))
    return text, content


def started(folder, cloud, *options):
    """Text and content of the site file of a cloud."""
    run(cloud, "-o", folder / "site.yaml", *options)
    return written(folder / "site.yaml")


def test_starter_file_of_a_good_cloud(tmp_path, capsys):
    classes = np.repeat([2, 6, 26, 7], [300, 100, 99, 1])
    cloud = write_las(
        tmp_path / "My Road (1).laz", random_points(500), UTM, classification=classes, intensity=5
    )
    text, content = started(tmp_path, cloud)
    assert content == {
        "site": "my_road_1",
        "title": "My Road (1)",
        "clouds": [str(cloud)],
        "crs": "auto",
        "units": "auto",
        "vertical_units": "auto",
        "jobs": ["placement"],
        "placement": {"plans": list(starter.FIRST_PLANS), "edges": None, "tma": None},
        "settings": {
            "shards": 1,
            "candidates": {"spacing_m": 8, "height_step_m": 2},
            "cover": {"time_limit_s": 5},
            "coverage": {"shards": 1, "felled": 0, "uncoverable": "exclude"},
        },
    }
    for part in (
        "499 points, 1 withheld, noise or synthetic left out",
        "2 ground 60.1%, 6 building 20.0%, 26 not a common class 19.8%",
        "auto takes ETRS89 / UTM zone 32N from the header",
        "here metre; z assumed to be in metre",
        "Intensity: yes. Colour: no.",
    ):
        assert part in text
    assert capsys.readouterr().out.startswith(f"wrote {tmp_path / 'site.yaml'}\n")


def test_extent_and_density_are_in_metres_whatever_the_unit(tmp_path):
    metres = random_points(20_000, extent=(50, 40, 5), corner=(638750, 221750, 100))
    foot = 1200 / 3937
    for name, xyz, crs in [
        ("m", metres, "EPSG:32119+5703"),
        ("ft", metres / foot, "EPSG:6543+6360"),
    ]:
        out = tmp_path / f"{name}.yaml"
        run(write_las(tmp_path / f"{name}.laz", xyz, wkt_of(crs)), "-o", out)
        text, _ = written(out)
        assert "Extent 50.0 x 40.0 m;" in text
        line = next(line for line in text.splitlines() if "Density" in line)
        assert float(line.split()[2]) == pytest.approx(10, rel=0.15)


def test_cloud_without_crs_must_be_filled_in(tmp_path, capsys):
    text, content = started(tmp_path, write_las(tmp_path / "a.laz", random_points(50)))
    assert content["crs"] is None
    assert "# Required: EPSG code" in text
    assert "units of the cloud" in text
    assert "fill in crs: EPSG code" in capsys.readouterr().out


def test_header_that_cannot_be_right_must_be_filled_in(tmp_path, capsys):
    text, content = started(
        tmp_path, write_las(tmp_path / "a.laz", random_points(50), wkt_of("EPSG:28992"))
    )
    assert content["crs"] is None
    assert "cannot be right" in text
    assert "fill in crs" in capsys.readouterr().out


def test_us_metres_need_a_vertical_unit(tmp_path, capsys):
    xyz = random_points(50, corner=(638750, 221750, 100))
    _, content = started(tmp_path, write_las(tmp_path / "a.laz", xyz, wkt_of("EPSG:32119")))
    assert content["crs"] == "auto"
    assert "fill in vertical_units" in capsys.readouterr().out


def test_degrees_get_a_projected_crs(tmp_path):
    xyz = random_points(50, extent=(0.002, 0.002, 9), corner=(9.0, 50.0, 100.0))
    assert (
        started(tmp_path, write_las(tmp_path / "a.laz", xyz, wkt_of("EPSG:4979"), scale=1e-8))[1][
            "target_crs"
        ]
        == "EPSG:32632"
    )


def test_an_existing_file_is_kept_without_force(tmp_path):
    cloud = write_las(tmp_path / "a.laz", random_points(5), UTM)
    out = tmp_path / "site.yaml"
    out.write_text("mine")
    with pytest.raises(InputError, match=r"exists already.*--force"):
        run(cloud, "-o", out)
    assert out.read_text() == "mine"
    run(cloud, "-o", out, "--force")
    assert written(out)[1]["site"] == "a"


def test_bad_input_writes_nothing(tmp_path):
    out = tmp_path / "site.yaml"
    one = write_las(tmp_path / "one.laz", random_points(5), UTM)
    two = write_las(tmp_path / "two.laz", random_points(5), wkt_of("EPSG:28992"))
    for clouds, message in [
        ([tmp_path / "none.laz"], "no such file"),
        ([one, two], "differ in CRS"),
    ]:
        with pytest.raises(InputError, match=message):
            run(*clouds, "-o", out)
    with pytest.raises(InputError, match="gives no name of a site"):
        run(one, "-o", out, "--site", "!!")
    assert not out.exists()


def test_default_place_and_relative_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ROADSIGHT_DATA", raising=False)
    (tmp_path / "data").mkdir()
    write_las(tmp_path / "data" / "a.laz", random_points(5), UTM)
    run("data/a.laz", "--site", "Main Street")
    _, content = written(tmp_path / "config" / "sites" / "main_street.yaml")
    assert content["site"] == "main_street"
    assert content["clouds"] == ["../../data/a.laz"]


def test_paths_below_the_data_folder_use_its_variable(tmp_path, monkeypatch):
    (tmp_path / "data" / "x").mkdir(parents=True)
    monkeypatch.setenv("ROADSIGHT_DATA", str(tmp_path / "data"))
    cloud = write_las(tmp_path / "data" / "x" / "a.laz", random_points(5), UTM)
    assert started(tmp_path, cloud)[1]["clouds"] == ["${ROADSIGHT_DATA}/x/a.laz"]


@needs_data
@pytest.mark.parametrize(
    ("name", "crs"),
    [("autzen_arterial", "auto"), ("montpellier_street", "auto"), ("nc_unit_trap", None)],
)
def test_real_clouds(tmp_path, name, crs):
    _, content = started(tmp_path, DATA / "clouds" / f"{name}.laz")
    assert content["crs"] == crs
    assert content["clouds"] == [f"${{ROADSIGHT_DATA}}/clouds/{name}.laz"]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Mühlstraße", "muehlstrasse"), ("MU\u0308HLE", "muehle"), ("Città 2", "citta_2"),
        ("Łódź", "lodz"), ("Улица Мира", "ulitsa_mira"), ("Οδός 3", "odos_3"),
        ("København", "koebenhavn"),
    ],
)  # fmt: skip
def test_letters_with_marks_stay_legible(tmp_path, text, name):
    cloud = write_las(tmp_path / f"{text}.laz", random_points(50), UTM)
    content = started(tmp_path, cloud)[1]
    assert content["site"] == name
    assert content["title"] == text


def test_a_name_that_cannot_be_written_out_is_asked_for(tmp_path):
    cloud = write_las(tmp_path / "道路.laz", random_points(50), UTM)
    with pytest.raises(InputError, match=r"道路\.laz.*--site NAME"):
        run(cloud, "-o", tmp_path / "site.yaml")
    assert started(tmp_path, cloud, "--site", "road")[1]["site"] == "road"


def test_what_is_commented_out_is_a_valid_key(tmp_path):
    cloud = write_las(tmp_path / "a.laz", random_points(50), UTM)
    text = started(tmp_path, cloud)[0].replace("# orthophoto:", "orthophoto:")
    assert Site(**yaml.safe_load(text)).orthophoto == "orthophoto.tif"


@pytest.mark.parametrize(
    ("out", "asked"),
    [(None, "a"), ("config/sites/b.yaml", "b"), ("elsewhere/c.yaml", "elsewhere/c.yaml")],
)
def test_it_says_what_was_found_and_what_comes_next(out, asked, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cloud = write_las(tmp_path / "a.laz", random_points(50), UTM)
    run(cloud, *([] if out is None else ["-o", out]))
    said = capsys.readouterr().out
    assert "50 points" in said and "ETRS89 / UTM zone 32N" in said
    assert f"snakemake -n --config 'sites=[{asked}]'" in said
    assert f"snakemake --cores 2 --config 'sites=[{asked}]'" in said
    files = {
        f"{n}_file": str(PROJECT / f"config/{n}.yaml") for n in ("effects", "plans", "sensors")
    }
    assert load_site(asked, Config(**files)).site.site == "a"
    assert "points per m2 are sparse" in said


def test_a_dense_cloud_is_not_doubted():
    assert starter.doubts(30.0) == [] and starter.doubts(None) == []


FILES = ("plans.yaml", "sensors.yaml")


def test_the_first_plans_are_known():
    assert set(starter.FIRST_PLANS) <= set(
        load_plans(*(str(PROJECT / "config" / f) for f in FILES))
    )
