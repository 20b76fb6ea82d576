import json

import pytest

from roadsight.base.errors import InputError
from roadsight.io.images.camera_tables import read_baselines


def test_what_is_stated_and_nothing_else(tmp_path):
    path = tmp_path / "baseline.json"
    stated = {"640x416": {"focal_px": 700.0, "sigma": {"yaw_deg": 0.1}, "pairs": 8, "rms_px": 0.4}}
    path.write_text(json.dumps(stated))
    assert read_baselines(path) == stated
    path.write_text(json.dumps({"all": {"hfov_deg": 90, "pitch_deg": -2}}))
    assert read_baselines(path) == {"all": {"hfov_deg": 90, "pitch_deg": -2, "sigma": {}}}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "must be a mapping"),
        ({"640": {}}, "640"),
        ({"all": 3}, "all"),
        ({"all": {"focal_px": -3}}, "focal_px"),
        ({"all": {"hfov_deg": 180}}, "hfov_deg"),
        ({"all": {"pich_deg": 1}}, "unknown key 'all.pich_deg'; did you mean 'pitch_deg'"),
        ({"all": {"xyz": 1}}, "valid names: along_m, focal_px, .*, sigma, yaw_deg"),
        ({"all": {"sigma": {"yaw": 1}}}, "unknown key 'all.sigma.yaw'; did you mean 'yaw_deg'"),
        ({"all": {"sigma": {"yaw_deg": 0}}}, "sigma.yaw_deg"),
        ({"all": {"sigma": [1]}}, "sigma"),
        ({"all": {"yaw_deg": "left"}}, "yaw_deg"),
    ],
)
def test_what_is_refused(tmp_path, content, message):
    path = tmp_path / "baseline.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message) as error:
        read_baselines(path)
    assert str(path) in str(error.value)
