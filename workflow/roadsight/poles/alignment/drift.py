"""Slowly varying error of the track: what neighbours tell about the place of one image.

A bend or a landmark seen by one image fixes its place along the road, a straight does not; but the
error of satellite positions changes slowly. It is taken as a Gauss-Markov process of first order
along the route, measured by the images that can; an image's own measurement is left out of its
expectation, so that nothing counts twice.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from functools import cached_property

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.sections.poles import Calibration
from roadsight.poles.alignment.pose import ALONG, LATERAL
from roadsight.poles.alignment.solve import Fit

_State = tuple[Floats, Floats]
# One standard deviation of what is said of a receiver beforehand, as logarithms of `DriftModel`:
# twice or half as much is as usual as not
_KNOWN = np.log([2.0, 2.0, 2.0])
# Degrees of freedom of a measurement's error: few, since some images take one pole for another
_TAILS = 4.0
# Squared scale of these tails for which normal errors in two directions give their true variance:
# E[(_TAILS + 2) d / (_SCALE + d)] = 2 for d of chi squared with 2 degrees of freedom
_SCALE = 3.0
_FEWEST = 8  # Measured places from which a receiver's errors are estimated
# One standard deviation of a place that counts as unknown: far beyond any error of a track
_UNKNOWN_M = 30.0
# Share of what road edges tell an image that is news: others see the same, errors included
OVERLAP = 0.05
MARK_OVERLAP = 0.5  # The same share of what landmarks tell


@dataclass(frozen=True)
class DriftModel:
    """Error of the track along the route.

    Parameters
    ----------
    sigma_m : one standard deviation. length_m : distance over which its correlation falls to
    1 / e. own_m : what each position has for itself.
    """

    sigma_m: float = Calibration().gps_sigma_m
    length_m: float = Calibration().gps_length_m
    own_m: float = Calibration().gps_own_m


@dataclass(frozen=True)
class Drift:
    """Measured errors of the track on one route, by station.

    Attributes
    ----------
    station_m : (n,) path along the route. offset_m : (n, 2) east and north.
    covariance_m2 : (n, 2, 2) of the offsets.
    """

    station_m: Floats
    offset_m: Floats
    covariance_m2: Floats
    model: DriftModel = field(default_factory=DriftModel)

    def at(self, station_m: float, leave_out: int | None = None) -> _State:
        """Expected error (2,) and its covariance (2, 2) at a station.

        Parameters
        ----------
        leave_out : number of the measurement not to use, the image's own.
        """
        order, ahead, back = self._swept
        place = self.station_m[order]
        before = int(np.searchsorted(place, station_m, side="right")) - 1
        if before >= 0 and order[before] == leave_out:
            before -= 1
        after = before + 1
        if after < len(order) and order[after] == leave_out:
            after += 1
        states = []
        if before >= 0:
            states.append(_moved(ahead[before], station_m - place[before], self.model))
        if after < len(order):
            states.append(_moved(back[after], place[after] - station_m, self.model))
        # Each of the two states holds the process's own spread already: it counts once.
        prior = np.eye(2) / self.model.sigma_m**2
        information, right = prior.copy(), np.zeros(2)
        for mean, covariance in states:
            own = np.linalg.inv(covariance)
            information += own - prior
            right += own @ mean
        found = np.asarray(np.linalg.inv(information), np.float64)
        return found @ right, 0.5 * (found + found.T) + np.eye(2) * self.model.own_m**2

    @cached_property
    def _swept(self) -> tuple[Ints, list[_State], list[_State]]:
        """Order of the stations; what all up to each say there, and what all from each on say."""
        order = np.argsort(self.station_m, kind="stable")
        return order, self._sweep(order), self._sweep(order[::-1])[::-1]

    def _sweep(self, order: Ints) -> list[_State]:
        states: list[_State] = []
        for k, number in enumerate(order):
            state = np.zeros(2), np.eye(2) * self.model.sigma_m**2
            if k:
                gap_m = abs(self.station_m[number] - self.station_m[order[k - 1]])
                state = _moved(states[-1], float(gap_m), self.model)
            own = self.covariance_m2[number] + np.eye(2) * self.model.own_m**2
            gain = np.linalg.solve(state[1] + own, state[1]).T
            mean = state[0] + gain @ (self.offset_m[number] - state[0])
            covariance = state[1] - gain @ state[1]
            states.append((mean, 0.5 * (covariance + covariance.T)))
        return states

    def fitted(self) -> Drift:
        """Drift under the likeliest model of its receiver; the same with few measurements.

        Receivers differ: with corrections the error is a few decimetres, without it is metres that
        take hundreds of metres to change. A model that is too stiff takes good measurements for
        outliers and lets images lean on places far away. The model maximises the likelihood of
        all measurements, each given those before it (Kalman's innovations, with the tails of
        Student's distribution), with the model as said beforehand, to a factor of 2, as prior.
        """
        if len(self.station_m) < _FEWEST:
            return self
        from scipy.optimize import minimize  # noqa: PLC0415  # slow to load

        said = np.log(astuple(self.model))

        def misfit(changed: Floats) -> float:
            model = DriftModel(*np.exp(said + changed * _KNOWN))
            return replace(self, model=model)._misfit() + 0.5 * float(changed @ changed)

        corners = np.vstack([np.zeros(3), np.eye(3)])
        options = {"xatol": 0.02, "fatol": 0.02, "maxfev": 200, "initial_simplex": corners}
        best = minimize(misfit, corners[0], method="Nelder-Mead", options=options).x
        return replace(self, model=DriftModel(*(float(v) for v in np.exp(said + best * _KNOWN))))

    def _misfit(self) -> float:
        """Negative log-likelihood of the measurements, in the order of the stations."""
        model, total = self.model, 0.0
        order = np.argsort(self.station_m, kind="stable")
        gaps_m = np.diff(self.station_m[order], prepend=-np.inf)
        state: _State = np.zeros(2), np.eye(2) * model.sigma_m**2
        for number, gap_m in zip(order, gaps_m, strict=True):
            mean, covariance = _moved(state, float(gap_m), model)
            own = self.covariance_m2[number] + np.eye(2) * model.own_m**2
            gap, full = self.offset_m[number] - mean, covariance + own
            far = float(gap @ np.linalg.solve(full, gap))
            total += 0.5 * float(np.linalg.slogdet(full)[1])
            total += 0.5 * (_TAILS + 2.0) * float(np.log1p(far / _SCALE))
            # A measurement that is far off moves what follows less, as its tails say.
            full = full + own * max((_SCALE + far) / (_TAILS + 2.0) - 1.0, 0.0)
            gain = np.linalg.solve(full, covariance).T
            state = mean + gain @ gap, covariance - gain @ covariance
        return total

    def without_outliers(self) -> tuple[Drift, Bools]:
        """Drift without measurements that their neighbours contradict, and which ones stay."""
        kept = np.ones(len(self.station_m), bool)
        # More than a quarter cannot be outliers: then something else is wrong.
        most = len(kept) // 4
        # The worst of a stretch first: an outlier makes its neighbours look like outliers.
        while most > 0:
            rest = self._part(kept)
            # Squared distance of each from what the others say, in standard deviations.
            surprise = np.empty(len(rest.station_m))
            for number, offset in enumerate(rest.offset_m):
                mean, covariance = rest.at(rest.station_m[number], number)
                gap = offset - mean
                full = covariance + rest.covariance_m2[number]
                surprise[number] = gap @ np.linalg.solve(full, gap)
            # Four sigmas; two numbers, east and north, so that the bound is twice that of one.
            worst = _peaks(rest.station_m, surprise, 2.0 * 4.0**2, self.model.length_m)[:most]
            if not len(worst):
                break
            kept[np.flatnonzero(kept)[worst]] = False
            most -= len(worst)
        return self._part(kept), kept

    def _part(self, kept: Bools) -> Drift:
        part = self.station_m[kept], self.offset_m[kept], self.covariance_m2[kept]
        return Drift(*part, self.model)


def _moved(state: _State, gap_m: float, model: DriftModel) -> _State:
    """State further along, either way."""
    keep = float(np.exp(-gap_m / model.length_m))
    return keep * state[0], keep**2 * state[1] + np.eye(2) * (1.0 - keep**2) * model.sigma_m**2


def _peaks(station_m: Floats, value: Floats, least: float, apart_m: float) -> list[int]:
    """Numbers of values above a bound, greatest first, none within a distance of a greater one."""
    found: list[int] = []
    for number in np.argsort(-value, kind="stable"):
        if value[number] < least:
            break
        if all(abs(station_m[number] - station_m[other]) >= apart_m for other in found):
            found.append(int(number))
    return found


def axes(heading_deg: float) -> Floats:
    """Rows: directions along and to the right of a heading, east and north."""
    heading = np.radians(heading_deg)
    return np.array([[np.sin(heading), np.cos(heading)], [np.cos(heading), -np.sin(heading)]])


def measured_offset(
    fit: Fit, mean: Floats, covariance: Floats, heading_deg: float
) -> tuple[Floats, Floats]:
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
    normal, gradient = fit.taught(OVERLAP, MARK_OVERLAP)
    full = np.linalg.inv(normal + known)
    unknowns = full @ (normal @ fit.unknowns - gradient + known @ mean)
    turn = axes(heading_deg)
    offset = turn.T @ (unknowns - mean)[place]
    return offset, turn.T @ full[np.ix_(place, place)] @ turn


def expect_place(
    mean: Floats, covariance: Floats, drift: tuple[Floats, Floats], heading_deg: float
) -> tuple[Floats, Floats]:
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
