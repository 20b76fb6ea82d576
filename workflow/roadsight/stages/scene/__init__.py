"""Stages from a cloud to its road."""
