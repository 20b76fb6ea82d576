"""Which physical effects a scene calls for, from quantities measured on it."""
