import numpy as np
import pytest
from pyproj import CRS, Geod

from roadsight.base.errors import InputError
from roadsight.geometry.cameras import azimuth_deg, wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth


def frame_of(epsg: int, origin: tuple[float, float, float], unit_m: float = 1.0) -> Frame:
    return Frame(origin, unit_m, unit_m, CRS.from_epsg(epsg).to_wkt())


SITES = [
    (32632, (458_000.0, 5_428_000.0, 0.0), 1.0),
    (6543, (900_000.0, 700_000.0, 0.0), 1200 / 3937),
    (2154, (770_000.0, 6_280_000.0, 0.0), 1.0),
]


@pytest.mark.parametrize(("epsg", "origin", "unit_m"), SITES)
def test_true_bearing_is_grid_bearing_plus_convergence(epsg, origin, unit_m) -> None:
    north = SiteNorth(frame_of(epsg, origin, unit_m))
    start, end = np.array([[10.0, 20.0]]), np.array([[40.0, 90.0]])
    (lat, lon), (lat2, lon2) = north.to_geographic(start), north.to_geographic(end)
    true, _, length = Geod(ellps="GRS80").inv(lon, lat, lon2, lat2)
    grid = azimuth_deg(start, end)
    assert abs(wrap_deg(true - grid - north.convergence_deg(start)))[0] < 2e-3
    assert length[0] == pytest.approx(np.hypot(30, 70), rel=1e-3)


@pytest.mark.parametrize(("epsg", "origin", "unit_m"), SITES)
def test_there_and_back(epsg, origin, unit_m) -> None:
    north = SiteNorth(frame_of(epsg, origin, unit_m))
    xy = np.random.default_rng(1).uniform(0, 5000, (50, 2))
    np.testing.assert_allclose(north.to_local(*north.to_geographic(xy)), xy, atol=1e-5)


def test_a_local_system_has_no_north() -> None:
    with pytest.raises(InputError, match="no latitude"):
        SiteNorth(Frame((0.0, 0.0, 0.0)))
