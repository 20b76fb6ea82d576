"""Scores against truth and the figures that go with a result."""
