"""Pavement: features of ground points, classes, outline, reflectivity."""
