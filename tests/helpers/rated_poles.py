"""Hazard of poles by tracks, edges and heights alone."""

from roadsight.poles.risk.hazard import rate_roadside
from roadsight.poles.risk.roads import roads_of
from roadsight.poles.risk.roadside import Surroundings


def rate_poles(poles, edges_m, tracks, height, settings):
    known = Surroundings(roads_of(tracks, edges_m), height)
    return rate_roadside(poles, edges_m, known, settings).table
