"""Hazard of located poles, and their validation."""
