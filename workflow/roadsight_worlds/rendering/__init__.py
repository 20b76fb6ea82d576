"""Images of the rural road."""
