"""Settings: one closed schema, from which the commented default file is generated."""
