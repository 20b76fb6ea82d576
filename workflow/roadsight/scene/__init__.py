"""Ground, DEM, pavement, road edges, surfels: pure functions on arrays."""
