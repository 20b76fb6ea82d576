"""Poles from rays with their errors."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.triangulate.explain import explain_rays
from roadsight.poles.triangulate.published import swept_poles
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

POLE_COLUMNS = [
    "x",
    "y",
    "score",
    "sigma_major_m",
    "sigma_minor_m",
    "sigma_azimuth_deg",
    "condition",
    "kept",
    "reason",
]


def triangulate(rays: Rays, settings: TriangulationSettings) -> tuple[pd.DataFrame, Ints, float]:
    """Poles with their errors.

    Parameters
    ----------
    settings : their method is ``sweep``: the pole study's, which states no errors (NaN) and
        withholds nothing; else groups by the evidence for them.

    Returns
    -------
    poles : one row each, columns `POLE_COLUMNS` and ``evidence`` (log odds that its rays show a
        pole and not strays), local metres; ``score`` is the number of views,
        ``condition`` the ratio of the error ellipse's variances; poles too weak to use have
        ``kept`` False and a reason.
    pole of each ray : row in ``poles``, -1 for none; shape (n,).
    scale : what depths were multiplied by; 1 if not calibrated.
    """
    if settings.method == "sweep":
        labels, places = swept_poles(rays, settings)
        order = np.lexsort((places[:, 1], places[:, 0]))
        rank = np.append(np.argsort(order), -1)
        unknown = dict.fromkeys(POLE_COLUMNS[3:-2], np.nan)
        views = np.bincount(labels[labels >= 0], minlength=len(places))
        poles = pd.DataFrame({"x": places[:, 0], "y": places[:, 1], "score": views}).iloc[order]
        poles = poles.reset_index(drop=True).assign(**unknown, kept=True, reason="")
        poles = poles.assign(evidence=np.nan).astype({"kept": bool, "reason": object})
        return poles, rank[labels], 1.0
    found = explain_rays(rays, settings)
    pole = np.full(len(rays), -1, np.int64)
    for number, members in enumerate(found.groups):
        pole[members] = number
    poles = describe_groups(found.groups, found.place_m, found.covariance, settings)
    return poles.assign(evidence=found.gain + settings.pole_evidence), pole, found.scale


def describe_groups(
    groups: list[Ints], places: Floats, covariances: Floats, settings: TriangulationSettings
) -> pd.DataFrame:
    """Poles of groups of rays with their errors; columns `POLE_COLUMNS`.

    Parameters
    ----------
    places : (g, 2), metres. covariances : (g, 2, 2), m2.
    """
    major, minor, azimuth = error_ellipse(covariances)
    weak = major > settings.max_sigma_m
    columns = [
        *places.T,
        np.array([len(members) for members in groups], np.int64),
        major,
        minor,
        azimuth,
        (major / minor) ** 2,
        ~weak,
        np.where(weak, f"error ellipse longer than {settings.max_sigma_m:g} m", "").astype(object),
    ]
    return pd.DataFrame(dict(zip(POLE_COLUMNS, columns, strict=True)))


def error_ellipse(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Semi-axes of the 1-sigma ellipse and the bearing of the longer one.

    Parameters
    ----------
    covariance : of x and y, m2, shape (n, 2, 2).

    Returns
    -------
    longer and shorter semi-axis, m; bearing clockwise from grid north, degrees in [0, 180)
    """
    variances, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(variances, 0.0)).T
    azimuth = np.degrees(np.arctan2(axes[:, 0, 1], axes[:, 1, 1])) % 180.0
    return major, minor, np.where(azimuth >= 180.0, 0.0, azimuth)
