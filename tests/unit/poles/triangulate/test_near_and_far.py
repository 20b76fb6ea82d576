import numpy as np

from roadsight.poles.triangulate.rays import TriangulationSettings, make_rays
from roadsight.poles.triangulate.site import near_and_far


def test_one_far_ray_shows_no_panel():
    depth_m = np.array([75.0])
    rays = make_rays(np.zeros((1, 2)), np.zeros(1), depth_m, np.ones(1), np.full(1, 5.0))
    poles, own, _ = near_and_far(rays, TriangulationSettings())
    assert len(poles) == 0 and own.tolist() == [-1]
