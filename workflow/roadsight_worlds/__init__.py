"""Analytic scenes with known truth."""
