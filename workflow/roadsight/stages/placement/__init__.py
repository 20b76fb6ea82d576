"""Stages of the placement job."""
