"""Results to look at and to review."""
