"""Voxels by class, and the overhead view of them."""
