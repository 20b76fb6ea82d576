import numpy as np
import pandas as pd

from roadsight.__main__ import main
from roadsight.poles.triangulate.geographic import reasons_for_none, triangulate_geographic
from roadsight.poles.triangulate.rays import UNAIDED

SETTINGS = UNAIDED


def table(depth=14.0, step_deg=1e-4):
    north = np.arange(3) * step_deg
    bearing = np.degrees(np.arctan2(10.0, 30.0 - north * 111_000))
    return pd.DataFrame({"lat": 51.0 + north, "lon": 7.0, "bearing": bearing, "depth": depth})


def test_far_depths_are_named():
    assert "beyond 40 m" in " ".join(reasons_for_none(table(depth=300.0), SETTINGS))


def test_lone_cameras_are_named():
    assert "too few sightings" in " ".join(reasons_for_none(table(step_deg=0.1), SETTINGS))


def test_exchanged_axes_are_named():
    good = table(depth=[31.6, 21.3, 12.7])
    assert len(triangulate_geographic(good, SETTINGS)) > 0
    swapped = good.rename(columns={"lat": "lon", "lon": "lat"})
    assert "exchanged" in reasons_for_none(swapped, SETTINGS)[0]


def test_there_is_always_a_reason():
    away = table().assign(bearing=[0.0, 120.0, 240.0], depth=5.0)
    assert reasons_for_none(away, SETTINGS)


def test_the_verb_refuses_exchanged_axes_and_says_why_it_finds_nothing(tmp_path, capsys):
    rows = table(depth=[31.6, 21.3, 12.7])
    swapped = tmp_path / "swapped.csv"
    rows.rename(columns={"lat": "lon", "lon": "lat"}).to_csv(swapped, index=False)
    out = tmp_path / "poles.csv"
    assert main(["triangulate", str(swapped), "-o", str(out)]) == 2
    assert "look exchanged" in capsys.readouterr().err and not out.exists()
    far = tmp_path / "far.csv"
    rows.assign(depth=1000.0).to_csv(far, index=False)
    assert main(["triangulate", str(far), "-o", str(out)]) == 0
    assert "are they metres?" in capsys.readouterr().out
