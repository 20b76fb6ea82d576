"""A synthetic street of poles and what cameras see of them."""

import numpy as np

from roadsight.poles.triangulate.explain import triangulate
from roadsight.poles.triangulate.rays import UNAIDED, make_rays

FINE = UNAIDED.model_copy(
    update={
        "sigma_position_m": 0.3,
        "sigma_bearing_deg": 0.5,
        "sigma_depth_ratio": 0.2,
        "calibrate_depth": False,
    }
)


def street(seed=3, poles=8, noise_deg=0.3, noise_depth=0.1, gap_m=8.0):
    """Poles beside a straight street and what cameras every 8 m see within 22 m ahead."""
    rng = np.random.default_rng(seed)
    truth = np.column_stack([20.0 * np.arange(1, poles + 1), rng.choice([-6.0, 7.0], poles)])
    rows = []
    for image, x in enumerate(np.arange(0, 20 * poles + 20, gap_m)):
        for target in truth:
            gap = target - [x, 0.0]
            depth = np.hypot(*gap)
            if gap[0] > 2 and depth < 22:
                bearing = np.degrees(np.arctan2(*gap)) + rng.normal(0, noise_deg)
                rows.append((x, 0.0, bearing, depth * np.exp(rng.normal(0, noise_depth)), image))
    return truth, np.array(rows)


def rays_of(rows, **more):
    return make_rays(rows[:, :2], rows[:, 2], rows[:, 3], image=rows[:, 4].astype(int), **more)


def found(rows, choice=FINE):
    poles, _, _ = triangulate(rays_of(rows), choice)
    return poles


def nearest(poles, truth):
    gaps = poles[["x", "y"]].to_numpy()[:, None] - truth
    return np.hypot(gaps[..., 0], gaps[..., 1])
