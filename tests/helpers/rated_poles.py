"""Drives as tables, and hazard of poles by tracks, edges and heights alone."""

import pandas as pd

from roadsight.poles.risk.hazard import rate_roadside
from roadsight.poles.risk.roads import roads_of
from roadsight.poles.risk.roadside import Surroundings


def track(xy, route="a"):
    """Images of one drive at places (n, 2)."""
    return pd.DataFrame({"route": route, "sequence": range(len(xy)), "x": xy[:, 0], "y": xy[:, 1]})


def rate_poles(poles, edges_m, tracks, height, settings):
    known = Surroundings(roads_of(tracks, edges_m), height)
    return rate_roadside(poles, edges_m, known, settings).table
