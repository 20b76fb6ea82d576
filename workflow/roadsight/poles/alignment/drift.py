"""Slowly varying error of the track: what neighbours tell about the place of one image.

A bend seen by one image fixes its place along the road, a straight does not; but the error of
satellite positions changes slowly. It is taken as a Gauss-Markov process of second order along
the route (a Matern 3/2 covariance), measured by the images that can; an image's own measurement
is left out of its expectation, so that nothing counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.poles.alignment.pose import ALONG, LATERAL
from roadsight.poles.alignment.solve import Fit

_FLOATS = NDArray[np.float64]
_NEIGHBOURS = 40
_UNKNOWN_M = 30.0
OVERLAP = 0.2
"""Share of what an image sees that other images do not see again, with the same errors."""


@dataclass(frozen=True)
class DriftModel:
    """Error of the track along the route.

    Parameters
    ----------
    sigma_m : one standard deviation. length_m : distance over which it stays alike.
    own_m : what each position has for itself.
    """

    sigma_m: float = 0.8
    length_m: float = 80.0
    own_m: float = 0.1


@dataclass(frozen=True)
class Drift:
    """Measured errors of the track on one route, by station.

    Attributes
    ----------
    station_m : (n,) path along the route. offset_m : (n, 2) east and north.
    covariance_m2 : (n, 2, 2) of the offsets.
    """

    station_m: _FLOATS
    offset_m: _FLOATS
    covariance_m2: _FLOATS
    model: DriftModel = DriftModel()

    def at(self, station_m: float, leave_out: int | None = None) -> tuple[_FLOATS, _FLOATS]:
        """Expected error (2,) and its covariance (2, 2) at a station.

        Parameters
        ----------
        leave_out : number of the measurement not to use, the image's own.
        """
        model = self.model
        gap = np.abs(self.station_m - station_m)
        near = np.argsort(gap, kind="stable")[: _NEIGHBOURS + 1]
        near = near[(gap[near] < 5 * model.length_m) & (near != leave_out)]
        prior = np.eye(2) * model.sigma_m**2
        own = np.eye(2) * model.own_m**2
        if not len(near):
            return np.zeros(2), prior + own
        place = self.station_m[near]
        among = np.kron(_alike(np.abs(place[:, None] - place), model), np.eye(2))
        to = np.kron(_alike(gap[near][None], model), np.eye(2))
        for k, number in enumerate(near):
            part = slice(2 * k, 2 * k + 2)
            among[part, part] += self.covariance_m2[number] + own
        gain = np.linalg.solve(among, to.T).T
        covariance = prior + own - gain @ to.T
        return gain @ self.offset_m[near].ravel(), 0.5 * (covariance + covariance.T)

    def without_outliers(self, limit: float = 4.0) -> tuple[Drift, NDArray[np.bool_]]:
        """Drift without measurements that their neighbours contradict, and which ones stay."""
        kept = np.ones(len(self.station_m), bool)
        # One at a time, the worst first: an outlier makes its neighbours look like outliers.
        for _ in range(len(kept) // 4):
            rest = self._part(kept)
            surprise = [rest._surprise(number) for number in range(kept.sum())]
            worst = int(np.argmax(surprise))
            if surprise[worst] < 2.0 * limit**2:
                break
            kept[np.flatnonzero(kept)[worst]] = False
        return self._part(kept), kept

    def _part(self, kept: NDArray[np.bool_]) -> Drift:
        part = self.station_m[kept], self.offset_m[kept], self.covariance_m2[kept]
        return Drift(*part, self.model)

    def _surprise(self, number: int) -> float:
        """Squared distance of a measurement from what the others say, in standard deviations."""
        mean, covariance = self.at(self.station_m[number], number)
        gap = self.offset_m[number] - mean
        return float(gap @ np.linalg.solve(covariance + self.covariance_m2[number], gap))


def _alike(gap_m: _FLOATS, model: DriftModel) -> _FLOATS:
    """Matern 3/2 covariance of one coordinate."""
    reach = np.sqrt(3.0) * gap_m / model.length_m
    return model.sigma_m**2 * (1.0 + reach) * np.exp(-reach)


def axes(heading_deg: float) -> _FLOATS:
    """Rows: directions along and to the right of a heading, east and north."""
    heading = np.radians(heading_deg)
    return np.array([[np.sin(heading), np.cos(heading)], [np.cos(heading), -np.sin(heading)]])


def measured_offset(
    fit: Fit, mean: _FLOATS, covariance: _FLOATS, heading_deg: float
) -> tuple[_FLOATS, _FLOATS]:
    """Error of the track that one image measures, were its place wholly unknown beforehand.

    Parameters
    ----------
    mean, covariance : (k,), (k, k) expected unknowns of the image.

    Returns
    -------
    offset (2,) east and north beyond the drive's mean, and its covariance (2, 2)
    """
    place = [ALONG, LATERAL]
    wide = covariance.copy()
    wide[place, :], wide[:, place] = 0.0, 0.0
    wide[place, place] = _UNKNOWN_M**2
    known = np.linalg.inv(wide)
    normal, gradient = OVERLAP * fit.normal, OVERLAP * fit.gradient
    full = np.linalg.inv(normal + known)
    unknowns = full @ (normal @ fit.unknowns - gradient + known @ mean)
    turn = axes(heading_deg)
    offset = turn.T @ (unknowns - mean)[place]
    return offset, turn.T @ full[np.ix_(place, place)] @ turn


def expect_place(
    mean: _FLOATS, covariance: _FLOATS, drift: tuple[_FLOATS, _FLOATS], heading_deg: float
) -> tuple[_FLOATS, _FLOATS]:
    """Expected unknowns and covariance once the error of the track is known that well.

    Parameters
    ----------
    mean, covariance : of the drive, the covariance without the spread of the place.
    drift : `Drift.at` the image.
    """
    turn = axes(heading_deg)
    place = [ALONG, LATERAL]
    moved, wider = mean.copy(), covariance.copy()
    moved[place] += turn @ drift[0]
    wider[np.ix_(place, place)] += turn @ drift[1] @ turn.T
    return moved, wider
