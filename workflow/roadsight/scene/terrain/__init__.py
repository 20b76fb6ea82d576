"""Ground, terrain model, and what the terrain hides."""
