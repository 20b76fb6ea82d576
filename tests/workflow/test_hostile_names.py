"""File names and texts of a user reach programs as they are, and never a shell."""

import json
import re
import shlex

import pytest
import yaml
from pyproj import CRS

from tests.helpers.las_files import random_points, wkt_of, write_las
from tests.workflow.conftest import Checkout

NAMES = (
    "two words",
    "a;touch pwned",
    "$(touch pwned)",
    "`touch pwned`",
    'it\'s "quoted"',
    "-rf",
    "--help",
    "a&b|c>d<e#f*g?h~i!",
    "new\nline",
    "back\\slash",
    "Straße",
)
TEXT = "';touch pwned;$(touch pwned)`touch pwned`\" -x"
CRS_TEXT = CRS.from_epsg(25832).to_wkt().replace("ETRS89 / UTM zone 32N", TEXT.replace('"', '""'))
"""A CRS that PROJ knows, by an evil name."""


@pytest.fixture
def checkout(tmp_path):
    return Checkout.copy_to(tmp_path / "checkout")


def write_site(checkout, **content):
    path = checkout.folder / "config/sites/tiny.yaml"
    path.write_text(yaml.safe_dump({"site": "tiny", **content}))


def decided(checkout):
    """All effects decided beforehand, so that nothing of a dry run waits for a measurement."""
    catalogue = yaml.safe_load((checkout.folder / "config/effects.yaml").read_text())
    return dict.fromkeys(catalogue["effects"], "simulate") | {"lens_distortion": "skip"}


def no_harm(checkout):
    return not list(checkout.folder.parent.rglob("pwned*"))


def test_braces_are_refused_before_anything_runs(checkout):
    write_site(checkout, clouds=["{wildcards.site}.laz"])
    result = checkout.snakemake("-n")
    message = [line for line in result.stderr.splitlines() if line.startswith("roadsight: ")]
    assert "a path with braces or null characters" in message[0]
    assert "Traceback" not in result.stderr


def test_clouds_of_any_name_are_read(checkout):
    folder = checkout.folder / "config/sites"
    for number, name in enumerate(NAMES):
        points = random_points(200, seed=number)
        write_las(folder / f"{name}.laz", points, wkt_of("EPSG:25832"))
    write_site(checkout, title=TEXT, clouds=[f"{name}.laz" for name in NAMES])
    result = checkout.snakemake("--cores", "1", "results/tiny/scene/frame.json")
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    frame = json.loads((checkout.folder / "results/tiny/scene/frame.json").read_text())
    assert len(frame["inputs"]) == len(NAMES)
    assert no_harm(checkout)


def test_every_text_of_a_user_is_one_word_of_its_command(checkout):
    """Commands as a dry run prints them, split as a shell would."""
    folder = checkout.folder / "config/sites"
    evil = {
        kind: f"{kind} ';touch pwned;$(touch pwned)`touch pwned`\" &x"
        for kind in (
            "edges", "tma", "truth", "images", "labels", "map", "depth", "sensors", "baseline"
        )
    }  # fmt: skip
    for name in ("cloud.laz", *evil.values()):
        (folder / name).write_text("")
    for kind in ("images", "labels", "depth"):
        (folder / evil[kind]).unlink()
        (folder / evil[kind]).mkdir()
    sensors = (checkout.folder / "config/sensors.yaml").read_text()
    (folder / evil["sensors"]).write_text(sensors)
    (folder / evil["baseline"]).write_text('{"all": {"hfov_deg": 60}}')
    (folder / "videolog.csv").write_text("image,lat,lon\na.jpg,49,8\n")
    write_site(
        checkout,
        title=TEXT,
        settings={"effects": decided(checkout)},
        clouds=["cloud.laz"],
        crs=CRS_TEXT,
        target_crs=CRS_TEXT,
        jobs=["placement", "poles"],
        placement={"edges": evil["edges"], "edges_crs": CRS_TEXT, "tma": evil["tma"]},
        poles={
            "videolog": "videolog.csv",
            "images": evil["images"],
            "masks": [{"labels": evil["labels"], "map": evil["map"]}],
            "depth": {"images": evil["depth"]},
            "baseline": evil["baseline"],
        },
        truth={
            "pavement": evil["truth"], "pavement_crs": CRS_TEXT, "poles": evil["truth"],
            "poles_crs": CRS_TEXT, "poles_kind": TEXT, "cameras": evil["truth"],
            "intrinsics": evil["truth"],
        },
    )  # fmt: skip
    sensors_file = f"sensors_file=config/sites/{evil['sensors']}"
    result = checkout.snakemake("-n", "-p", "--config", "sites=[tiny]", sensors_file)
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    commands = re.findall(r"python -m roadsight\.stages\..*?2>&1", result.stdout, re.DOTALL)
    words = [word for command in commands for word in shlex.split(command)]
    assert len(commands) > 30
    whole = (" &x", TEXT, CRS_TEXT)
    lists = [word for word in words if word.startswith("--lists=")]
    assert lists and all(json.loads(word.removeprefix("--lists=")) for word in lists)
    others = [word for word in words if word not in lists]
    assert [word for word in others if "pwned" in word and not word.endswith(whole)] == []
    for kind, name in evil.items():
        assert any(word.endswith(name) for word in words), kind
    assert sum(TEXT in word or CRS_TEXT in word for word in words) >= 6
    assert no_harm(checkout)
