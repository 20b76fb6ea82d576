"""An orthophoto of the generated sites."""

import numpy as np
import rasterio


def photo(path, frame, epsg=6543, west=0.0, north=40.0, metres=0.5, **changes):
    """GeoTIFF of 100 m by 40 m at local (0, 0): red in the west, blue in the east."""
    pixels = np.zeros((3, int(40 / metres), int(100 / metres)), np.uint8)
    pixels[0, :, : pixels.shape[2] // 2] = 200
    pixels[2, :, pixels.shape[2] // 2 :] = 220
    corner, cell = frame.to_native([west, north]), metres / frame.unit_m
    profile = {
        "driver": "GTiff",
        "width": pixels.shape[2],
        "height": pixels.shape[1],
        "count": 3,
        "dtype": "uint8",
        "crs": None if epsg is None else f"EPSG:{epsg}",
        "transform": rasterio.Affine(cell, 0, corner[0], 0, -cell, corner[1]),
    } | changes
    with rasterio.open(path, "w", **profile) as file:
        file.write(pixels[: profile["count"]].astype(profile["dtype"]))
    return path
