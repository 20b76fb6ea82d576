"""Budgets, curves, failures, spacing: deployments beyond the cheapest cover."""
