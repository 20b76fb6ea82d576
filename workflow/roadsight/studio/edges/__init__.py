"""Edges, zones and mounts drawn on the cloud."""
