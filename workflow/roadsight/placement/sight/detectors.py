"""How well sensors of all kinds see targets: one question to a sensor in a pose.

A detector measures targets of any shape in a unit of its own, and says from where on one is seen.
Solid-state LiDARs count expected points, cameras pixels, radars the echo over what they need.
Spinning LiDARs in a pose count beams; as mounted they have depth maps of their own
(`roadsight.placement.sight.sight`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.placement.sensors.rays import (
    Raster,
    camera_raster,
    radar_raster,
    rosette_raster,
    spinning_raster,
)
from roadsight.placement.sensors.sensors import AnySensor, Camera, Radar, Rosette, Sensor
from roadsight.placement.sight.kinds import Shape
from roadsight.placement.sight.posed import Panorama, weigh_by_height
from roadsight.placement.sight.sight import Sight, as_met


@dataclass(frozen=True)
class Criteria:
    """When targets count as seen, beyond what a sensor's definition says.

    Parameters
    ----------
    min_beams : LiDARs need more beams or points than this. rcs_m2 : radar cross-section of targets.
    min_pixels : what cameras need instead of what their definitions say.
    """

    min_beams: float
    rcs_m2: float
    min_pixels: int | None = None


def detector_of(
    sensor: AnySensor, criteria: Criteria
) -> BeamDetector | CameraDetector | RadarDetector:
    """The detector of a sensor."""
    if isinstance(sensor, Camera):
        return CameraDetector(camera_raster(sensor), criteria.min_pixels or sensor.min_pixels)
    if isinstance(sensor, Radar):
        return RadarDetector(sensor, criteria.rcs_m2)
    if isinstance(sensor, Rosette):
        return BeamDetector(sensor, rosette_raster(sensor), criteria.min_beams, "expected points")
    if isinstance(sensor, Sensor):
        return BeamDetector(sensor, spinning_raster(sensor), criteria.min_beams, "beams")
    raise TypeError(f"no detector for {type(sensor).__name__}")


class BandedDetector(ABC):
    """A sensor whose measure of a target is the sum over parts of the target's height.

    Parameters
    ----------
    raster : its beams or pixels.
    """

    raster: Raster

    def measure(
        self, panorama: Panorama, rotation: Floats, feet_m: Floats, shape: Shape, sight: Sight
    ) -> Floats:
        """How well each target (n,) is seen, 0 for not at all.

        Parameters
        ----------
        rotation : (3, 3) whose columns are the sensor's axes in the local frame.
        feet_m : (n, 3) local metres. shape : of every target. sight : effects.
        """
        return self.by_height(panorama, rotation, feet_m, shape, sight, 1)[:, 0]

    def by_height(
        self,
        panorama: Panorama,
        rotation: Floats,
        feet_m: Floats,
        shape: Shape,
        sight: Sight,
        bands: int,
    ) -> Floats:
        """What `measure` gives, by equal parts of the height, the lowest first, (n, bands)."""
        if sight.curved:
            feet_m = as_met(feet_m, panorama.position_m)
        found = (panorama, self.raster, rotation, feet_m, shape.packed, sight.max_range_m)
        return weigh_by_height(*found, self.beam(sight), bands)[:, 1:]

    @abstractmethod
    def beam(self, sight: Sight) -> tuple[float, float, float] | None:
        """Divergence across and upright, rad, and aperture, m; None for rays without width."""


@dataclass(frozen=True)
class BeamDetector(BandedDetector):
    """A LiDAR: beams, or points expected in a frame, that return from a target."""

    sensor: Sensor | Rosette
    raster: Raster
    min_beams: float
    unit: str

    def beam(self, sight: Sight) -> tuple[float, float, float] | None:
        """Of the definition, where wide beams are simulated."""
        if not sight.footprints or self.sensor.divergence_mrad is None:
            return None
        across_mrad, upright_mrad = self.sensor.divergence_mrad
        return across_mrad / 1000, upright_mrad / 1000, self.sensor.aperture_mm / 1000

    def sees(self, measured: Floats) -> Bools:
        """Those with more than the least number of beams."""
        return np.asarray(measured > self.min_beams)


@dataclass(frozen=True)
class CameraDetector(BandedDetector):
    """A camera: pixels whose middles show a target, and how many of them it needs."""

    raster: Raster
    min_pixels: int
    unit: str = "pixels"

    def beam(self, sight: Sight) -> None:
        """Pixels have no width: their middles count."""

    def sees(self, measured: Floats) -> Bools:
        """Those on enough pixels."""
        return np.asarray(measured >= self.min_pixels)


@dataclass(frozen=True)
class RadarDetector:
    """A radar: echo of a target over the weakest that it finds.

    By the radar equation the echo falls with the fourth power of the range and grows with the
    cross-section, of which the scene hides a share; a zone finds a cross-section sigma as far as
    R (sigma / sigma_0)^(1/4). A target counts for the zones within whose angles its middle lies and
    whose resolution there is no wider than the definition asks.
    """

    sensor: Radar
    rcs_m2: float
    unit: str = "echo over the least"

    def measure(
        self, panorama: Panorama, rotation: Floats, feet_m: Floats, shape: Shape, sight: Sight
    ) -> Floats:
        """Power of the echo over the weakest that is found."""
        if sight.curved:
            feet_m = as_met(feet_m, panorama.position_m)
        strength = self.rcs_m2 / self.sensor.range_rcs_m2
        farthest_m = self.sensor.range_m * max(strength, 1e-12) ** 0.25
        raster = radar_raster(self.sensor)
        looked_at = (panorama, raster, rotation, feet_m, shape.packed, farthest_m)
        met, seen = weigh_by_height(*looked_at, beam=None, bands=1).T
        share = np.divide(seen, met, out=np.zeros_like(seen), where=met > 0)
        middles = feet_m[:, :3] - panorama.position_m + np.array([0.0, 0.0, shape.height_m / 2])
        ahead, left, _ = (middles @ rotation).T
        azimuth_deg = np.degrees(np.abs(np.arctan2(left, ahead)))
        range_m = np.maximum(np.linalg.norm(middles, axis=1), 1e-6)
        best = np.zeros(len(feet_m))
        for zone in self.sensor.zones:
            cell_m = range_m * np.radians(zone.resolution_deg)
            inside = (azimuth_deg <= zone.half_angle_deg) & (cell_m <= self.sensor.widest_cell_m)
            best = np.where(inside, np.maximum(best, (zone.range_m / range_m) ** 4), best)
        return np.asarray(best * strength * share)

    def sees(self, measured: Floats) -> Bools:
        """Those whose echo is strong enough."""
        return np.asarray(measured >= 1.0)
