"""Frames, CRS and units, rotations, rays; conventions stated once."""
