"""Stages that measure the product on real data: one module an area."""
