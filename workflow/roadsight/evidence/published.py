"""What the two studies report: placement of roadside LiDAR, and pole geolocation.

Fig. 18a of the placement study gives the numbers of sensors as bars, of which the text repeats
five; its Figs. 19 and 20b are curves without numbers in the text.
"""

from __future__ import annotations

from statistics import fmean

# Keys, names and units of what the placement study says of each site (its Table 2).
SITE_FACTS = (
    ("points", "points", ""),
    ("spacing_m", "average spacing of points", "m"),
    ("length_m", "length", "m"),
    ("lane_width_m", "lane width", "m"),
    ("lanes", "lanes", ""),
    ("radius_m", "radius", "m"),
)
# The same; of the crossing of Site 3 the major road.
SITES: dict[str, dict[str, float | None]] = {
    name: {key: value for (key, _, _), value in zip(SITE_FACTS, values, strict=True)}
    for name, values in {
        "Site 1": (1_405_000, 0.1, 243.0, 3.5, 2, 120.0),
        "Site 2": (3_724_184, 0.05, 252.0, 3.75, 4, 1670.0),
        "Site 3": (3_361_904, 0.05, 269.0, 3.75, 4, None),
    }.items()
}
# Segmented pavement, per cent (its Table 4).
PAVEMENT = {
    "Site 1": {"accuracy": 91.84, "recall": 88.96, "f1": 90.38},
    "Site 2": {"accuracy": 94.45, "recall": 98.18, "f1": 96.28},
}
# Its deployment plans.
PLANS = ("VLP-16", "Puck 32C", "Puck 32C or OS-32", "OS-32", "OS-64", "OS-128")
# Sensors of its plans, as far as the text says.
SENSORS = {
    "Site 1": {"VLP-16": 31, "Puck 32C or OS-32": 13, "OS-128": 7},
    "Site 2": {"Puck 32C or OS-32": 10},
    "Site 3": {"Puck 32C or OS-32": 12},
}
# Products that are sold, by the study's sensors.
PRODUCTS = {
    "table5-VLP-16": "VLP-16",
    "table5-Puck-32C": "VLP-32C",
    "table5-OS-32": "OS1-32",
    "table5-OS-64": "OS1-64",
    "table5-OS-128": "OS1-128",
}
POLES = 180  # Poles that the paper located.
CHECKED = 29  # Of them, those whose places were known.
MEAN_M = 6.3  # Mean distance between located and known poles.
STD_M = 5.7  # Standard deviation of this distance.
WITHIN_75_M = 8.4  # Three quarters of the poles lie within this distance.
ACROSS_75_M = 2.1  # Three quarters of the poles lie within this distance across the road.
# By threshold in metres (Table 2).
SCORES = {
    3: {"precision": 0.34, "recall": 0.36, "f1": 0.35},
    5: {"precision": 0.55, "recall": 0.57, "f1": 0.56},
    7: {"precision": 0.72, "recall": 0.72, "f1": 0.72},
    9: {"precision": 0.79, "recall": 0.79, "f1": 0.79},
    11: {"precision": 0.86, "recall": 0.86, "f1": 0.86},
    15: {"precision": 0.90, "recall": 0.90, "f1": 0.90},
    16: {"precision": 0.93, "recall": 0.93, "f1": 0.93},
}
F1 = {threshold: scores["f1"] for threshold, scores in SCORES.items()}
# Stage, minutes a mile, cores, and our rules that do the same (Table 4).
STAGES = (
    ("Image segmentation", 1.28, 16, ("segment_images",)),
    ("Monocular depth prediction", 5.1, 1, ("estimate_depth",)),
    ("LiDAR processing", 0.25, 32, ("rasterise_lidar", "extract_road_edges", "build_terrain")),
    ("Road lane detection", 0.09, 32, ("trace_image_edges",)),
    ("Camera parameters by road alignment", 4.47, 96, ("calibrate_drive", "align_cameras")),
    ("Mapping input", 1.01, 64, ("trace_pole_axes", "find_pole_columns", "measure_poles")),
    ("Object geolocation", 0.01, 1, ("triangulate_poles",)),
)
# Images that show fewer poles than at native height, per cent, by height in px (section 4.3).
FEWER_POLES = {256: 29.87, 512: 12.77, 1024: 5.90}
# Minutes a mile of the segmentation by height in px; 0: native.
HEIGHT_MINUTES = {256: 0.71, 512: 1.28, 1024: 3.15, 0: 3.36}
# Time of rasterising on 32 cores, and points, by edge of a voxel in feet (section 4.3).
VOXELS = {
    1: {"seconds": 94, "points": 5_172_679, "edge points": 99_361},
    3: {"seconds": 21, "points": 589_888, "edge points": 32_528},
    5: {"seconds": 14, "points": 217_722, "edge points": 19_466},
    10: {"seconds": 11, "points": 57_748, "edge points": 9_665},
}
_STRAIGHT, _CURVED, _INTERSECTION, _EXTRANEOUS = SCENARIOS = (
    "straight road", "curved road", "intersection", "extraneous features",
)  # fmt: skip
# Distances in metres (Table 3).
_ERRORS_M = {
    _STRAIGHT: (0.64, 1.09, 1.16, 1.89, 2.14, 2.24, 2.49, 2.67, 3.44, 4.46, 5.47, 6.91, 8.80,
                10.74, 14.18, 22.97),
    _CURVED: (1.04, 2.79, 3.38, 3.87, 4.39, 4.60, 5.32, 5.38, 5.54, 8.44, 10.32, 15.53, 21.08),
    _INTERSECTION: (1.09, 1.16, 2.79, 4.46, 5.47, 5.54),
    _EXTRANEOUS: (10.32, 10.74, 14.18, 22.97),
}  # fmt: skip
# Title and what the paper says of each component (Table 1); it gives no numbers.
COMPONENTS = {
    "lidar_bearing": ("LiDAR-guided bearing", "essential: without it accuracy consistently drops"),
    "alignment": ("Road-edge alignment", "critical where the camera's parameters are unknown"),
    "occlusion": (
        "Occlusion filtering by ray casting",
        "optional in flat terrain, essential on slopes",
    ),
    "side_views": ("Side-view stitching", "essential for objects that only side views show"),
    "deterministic_mrf": (
        "Deterministic triangulation",
        "essential for the same result in every run",
    ),
}


def scenario_mean_m(scenario: str) -> tuple[int, float] | None:
    """Number of poles and mean error in metres that the paper has for a scenario, if any."""
    errors = _ERRORS_M.get(scenario.replace("_", " ").lower())
    return None if errors is None else (len(errors), fmean(errors))
