"""The generated rural road, its airborne scanner and its videolog."""
