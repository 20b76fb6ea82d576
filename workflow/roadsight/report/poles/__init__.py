"""What the report shows of poles at a site."""
