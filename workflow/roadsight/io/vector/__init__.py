"""Vector layers and tables of lines and points."""
