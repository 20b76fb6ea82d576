"""Covers in which several choices together see a target often enough."""
