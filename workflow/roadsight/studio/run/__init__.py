"""Runs of the workflow from the studio."""
