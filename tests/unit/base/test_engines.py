import importlib
import importlib.util
from pathlib import Path

import pytest

from roadsight.base import engines
from roadsight.base.errors import InputError
from roadsight.config.load import check_engines, load_site
from roadsight.config.schema import Config
from scripts import check_machine

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def missing(monkeypatch):
    """Two system libraries are missing."""
    gone = ("libGL.so.1", "libX11.so.6")

    def fail(name):
        raise OSError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(importlib, "import_module", fail)
    monkeypatch.setattr(engines, "_loads", lambda name: name not in gone)


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"lidar\.engine: .*open3d-cpu.*requirements-open3d"):
        engines.open3d("lidar.engine")


@pytest.mark.usefixtures("missing")
def test_all_missing_system_packages_are_named():
    with pytest.raises(InputError, match=r"missing libGL.*apt-get install libgl1 libx11-6"):
        engines.open3d()


@pytest.mark.usefixtures("missing")
def test_whoever_installs_is_told(capsys):
    assert engines.main() == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.usefixtures("missing")
def test_what_is_installed_may_be_unusable(monkeypatch):
    assert engines.is_installed() and not engines.is_usable()
    monkeypatch.setattr(importlib, "import_module", lambda name: object())
    assert engines.is_usable()  # a version that needs none of what is missing


def test_what_cannot_be_loaded_for_another_reason_says_why(monkeypatch):
    def fail(name):
        raise ImportError("no module named dash")

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(importlib, "import_module", fail)
    monkeypatch.setattr(engines, "_loads", lambda name: True)
    with pytest.raises(InputError, match="no module named dash"):
        engines.open3d()


def asked(tmp_path, settings: str):
    file = tmp_path / "config" / "mine.yaml"
    file.parent.mkdir()
    file.write_text(f"site: mine\nsample: {{}}\njobs: [placement]\nsettings: {settings}\n")
    return {"mine": load_site(str(file), Config())}


@pytest.mark.usefixtures("missing")
@pytest.mark.parametrize(
    "setting",
    [
        "pavement: {fpfh_engine: open3d}",
        "pavement: {cluster_engine: open3d}",
        "lidar: {engine: open3d}",
        "lidar: {outlier_engine: open3d}",
    ],
)
def test_a_run_ends_before_any_work(tmp_path, monkeypatch, setting):
    monkeypatch.chdir(ROOT)
    sites = asked(tmp_path, f"{{{setting}}}")
    with pytest.raises(InputError, match=r"mine\.yaml: .*engine: .*libgl1"):
        check_engines(sites)


@pytest.mark.usefixtures("missing")
def test_the_default_needs_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    check_engines(asked(tmp_path, "{}"))


@pytest.mark.parametrize(
    ("glibc", "machine", "reason"),
    [
        (("glibc", "2.35"), "x86_64", ""),
        (("glibc", "2.41"), "x86_64", ""),
        (("glibc", "2.28"), "x86_64", "glibc 2.35"),
        (("", ""), "x86_64", "no glibc"),
        (("glibc", "2.39"), "aarch64", "x86_64"),
    ],
)
def test_the_wheel_fits_or_a_line_says_why_not(monkeypatch, capsys, glibc, machine, reason):
    monkeypatch.setattr(check_machine.sys, "platform", "linux")
    monkeypatch.setattr(check_machine.platform, "libc_ver", lambda: glibc)
    monkeypatch.setattr(check_machine.platform, "machine", lambda: machine)
    assert check_machine.main(["open3d"]) == int(bool(reason))
    told = capsys.readouterr().err
    assert told.count("\n") == int(bool(reason)) and reason in told


def pins(name: str) -> set[str]:
    """``package==version`` of a lock, without markers and hashes."""
    lines = (ROOT / "envs" / name).read_text("utf-8").splitlines()
    return {line.split()[0] for line in lines if line[:1].isalnum()}


def test_locks_agree():
    product, engine, dev = (pins(f"requirements{part}.lock") for part in ("", "-open3d", "-dev"))
    assert product <= dev
    tools = {pin.split("==")[0] for pin in dev}
    assert {pin for pin in engine if pin.split("==")[0] in tools} <= dev
    names = {pin.split("==")[0] for pin in engine - product}
    assert "open3d-cpu" in names
    assert "open3d-cpu" not in tools, "tests run where no wheel of Open3D fits"
    assert not names & {pin.split("==")[0] for pin in product}
    opencv = {pin.split("==")[0] for pin in dev if "opencv" in pin}
    assert opencv == {"opencv-contrib-python-headless"}
