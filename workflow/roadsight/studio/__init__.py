"""The local web application: see it, draw it, register it, run it."""
