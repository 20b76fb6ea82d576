"""Cameras registered by hand."""
