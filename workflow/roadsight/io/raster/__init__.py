"""GeoTIFF rasters."""
