"""Which targets a sensor sees, and what hides the others."""
