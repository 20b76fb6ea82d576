"""Cheapest covers: local search, enumeration, proof."""
