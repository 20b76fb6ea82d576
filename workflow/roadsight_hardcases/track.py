"""Headings and places along a drive."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Numbers
from roadsight.geometry.cameras import Intrinsics, wrap_deg
from roadsight.poles.alignment.track import sides_of_track
from roadsight.poles.drive.videolog import headings_deg, split_drives
from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.poles.sightings.sighting_bearing import ViewCamera, matching_columns
from roadsight_hardcases.case import Errors, hard_case


def _chords_deg(xy_m: Numbers) -> Numbers:
    """Directions to the next place by the book; what is behind the last place is zero."""
    east, north = np.diff(xy_m, axis=0, append=xy_m[-1:]).T
    return np.degrees(np.arctan2(east, north)) % 360


def _off_deg(heading_deg: Numbers, true_deg: float) -> float:
    return float(np.abs(wrap_deg(heading_deg - true_deg)).max())


@hard_case("read_videolog", bound=1.0, unit="deg")
def heading_across_north(rng: np.random.Generator) -> Errors:
    """The mean of 359 and 1 degrees is 180: smoothed headings turn the vehicle round."""
    xy = np.column_stack([rng.normal(0, 0.05, 40), 8.0 * np.arange(40)])
    naive = np.convolve(_chords_deg(xy)[:-1], np.ones(7) / 7, mode="valid")
    return _off_deg(naive, 0.0), _off_deg(headings_deg(xy)[0], 0.0)


@hard_case("read_videolog", bound=1.0, unit="deg, mean over the drive")
def heading_in_a_hairpin(rng: np.random.Generator) -> Errors:
    """The way to the next image is off by half of the turn to it: in a hairpin 10 degrees."""
    radius_m, leg_m, step_m = 12.0, 60.0, 4.0
    station = np.arange(0, 2 * leg_m + np.pi * radius_m, step_m)
    turn = np.clip((station - leg_m) / radius_m, 0, np.pi)
    straight = np.minimum(station, leg_m) - np.maximum(station - leg_m - np.pi * radius_m, 0)
    xy = np.column_stack([radius_m * (1 - np.cos(turn)), straight + radius_m * np.sin(turn)])
    off = [wrap_deg(part - np.degrees(turn)) for part in (_chords_deg(xy), headings_deg(xy)[0])]
    return np.abs(off[0][:-1]).mean(), np.abs(off[1]).mean()


@hard_case("read_videolog", bound=0.1, unit="deg")
def last_image_of_a_route(rng: np.random.Generator) -> Errors:
    """The last image has no next one: its difference is zero and its heading north."""
    turn = np.radians(130.0)
    xy = 8.0 * np.arange(10)[:, None] * [np.sin(turn), np.cos(turn)]
    return _off_deg(_chords_deg(xy), 130.0), _off_deg(headings_deg(xy)[0], 130.0)


@hard_case("read_videolog", bound=2.0, unit="deg")
def standing_vehicle(rng: np.random.Generator) -> Errors:
    """While the vehicle waits at a light, GPS noise of 2 cm turns it anywhere."""
    xy = np.column_stack([8.0 * np.r_[0:10, [9] * 12, 10:20], np.zeros(32)])
    xy = xy + rng.normal(0, 0.02, xy.shape)
    return _off_deg(_chords_deg(xy)[:-1], 90.0), _off_deg(headings_deg(xy)[0], 90.0)


@hard_case("read_videolog", bound=2.0, unit="deg")
def stray_position(rng: np.random.Generator) -> Errors:
    """One position that is 5 km off turns the images around it towards it."""
    xy = np.column_stack([8.0 * np.arange(30), np.zeros(30)])
    xy[15] += [300.0, 5000.0]
    drives, stray_m = split_drives(xy)
    ours = np.concatenate([headings_deg(xy[drive])[0] for drive in drives])
    others = np.delete(np.arange(29), 15)
    missed = 180.0 * (stray_m[15] == 0 or len(ours) < 29)
    return _off_deg(_chords_deg(xy)[others], 90.0), max(_off_deg(ours, 90.0), missed)


@hard_case("measure_poles", bound=0.5, unit="poles of the cloud missed")
def bearings_around_north(rng: np.random.Generator) -> Errors:
    """Bearings of 359.9 and 0.1 degrees differ by 359.8 where they are subtracted."""
    columns_xy = np.array([[-0.05, 30.0], [0.05, 30.0]])
    camera = ViewCamera(Intrinsics.centred(1920, 1200, 1600.0), (0.0, 0.0, 2.0), 0.0)
    seen = np.array([0.05, 359.95])
    naive = ours = 0.0
    for place, bearing in zip(columns_xy, seen, strict=True):
        direction = np.degrees(np.arctan2(*place)) % 360
        naive += not abs(direction - bearing) <= 2 * 0.3
        unknown = np.array([np.nan])
        fields = dict.fromkeys(PoleColumns.__dataclass_fields__, np.zeros(1))
        columns = PoleColumns(**fields | {"xy_m": place[None], "sigma_m": np.array([0.02])})
        sighting = np.array([bearing]), np.array([0.3]), unknown, unknown
        found = matching_columns(camera, columns, *sighting, 60.0)
        ours += found[0] != 0
    return naive, ours


@hard_case("align_cameras", bound=0.005, unit="share of points")
def sides_where_the_track_turns(rng: np.random.Generator) -> Errors:
    """Left and right by the nearest track point alone are swapped inside bends."""
    angle = np.linspace(0, np.pi, 9)
    track = 40.0 * np.column_stack([1 - np.cos(angle), np.sin(angle)])
    bearing = rng.uniform(0.15, np.pi - 0.15, 2000)
    radius = 40.0 + rng.choice([-1.0, 1.0], 2000) * rng.uniform(3.5, 12.0, 2000)
    points = np.column_stack([40.0 - radius * np.cos(bearing), radius * np.sin(bearing)])
    true = np.where(radius > 40.0, -1, 1)
    nearest = np.argmin(np.hypot(*(points[:, None] - track).transpose(2, 0, 1)), axis=1)
    way = np.diff(track, axis=0, append=track[-1:])[nearest]
    gap = points - track[nearest]
    naive = np.sign(way[:, 1] * gap[:, 0] - way[:, 0] * gap[:, 1])
    ours = sides_of_track(points, track)
    return np.mean(naive != true), np.mean(ours != true)
