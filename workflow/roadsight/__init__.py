"""Roadside LiDAR placement and utility-pole mapping on one road scene."""

__version__ = "0.1.0"
