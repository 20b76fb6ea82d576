"""Stages of the pole job."""
