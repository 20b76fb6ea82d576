"""Videologs, images, label images, networks."""
