"""What the report shows of placement at a site."""
