"""Which rays show one pole: hypotheses grown from pairs of rays, chosen by what they explain.

A pole at a place predicts the bearing and the distance of its sightings. Each sighting that fits
speaks for it by the ratio of its likelihood to that of a stray sighting; each image that should
show the pole and does not speaks against it. The place itself is integrated out (Laplace), so that
a hypothesis that leaves it open pays less for being new and one of two poles on the same rays is
not free: the score of multiple-hypothesis tracking (Reid 1979; Blackman and Popoli 1999).

Every hypothesis is grown among the rays near one ray, from places where that ray meets a few
partners: work grows with the number of rays, not of groups.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled, compiled_part
from roadsight.poles.triangulate.rays import FURTHEST_CAMERAS, Rays, TriangulationSettings

# Partners from which each ray grows hypotheses, the best ones: with 16 precision and recall of
# simulated streets and junctions are the same within 0.2 %; time grows with it.
PARTNERS = 8
SETTLED = 1e-9  # a gain must exceed this to count: rounding is no evidence
_DIGITS = 9  # gains that agree in these decimals are ties, and the lower ray numbers come first


@dataclass(frozen=True)
class Neighbours:
    """Rays whose cameras may share a pole with each ray's, by image.

    Parameters
    ----------
    start : (n + 1,) where each ray's neighbours begin in ``ray``. ray : numbers; rays of one image
    follow each other; the ray itself and its image's others are among them.
    """

    start: Ints
    ray: Ints

    def of(self, ray: int) -> Ints:
        """Rays that may show the pole of a ray."""
        return self.ray[self.start[ray] : self.start[ray + 1]]


@dataclass(frozen=True)
class Pole:
    """A hypothesis.

    Parameters
    ----------
    members : ray numbers, ascending. x, y : place, metres. gain : log evidence against all members
    being strays. seed : the ray that it grew from.
    """

    members: Ints
    x: float
    y: float
    gain: float
    seed: int

    @property
    def key(self) -> tuple[int, ...]:
        """What tells hypotheses apart."""
        return tuple(self.members.tolist())


@dataclass
class Work:
    """Operations, counted so that their growth can be tested: no clock is the same twice."""

    pairs: int = 0
    looks: int = 0


@dataclass
class Grower:
    """Grows and judges hypotheses among rays."""

    rays: Rays
    near: Neighbours
    model: Likelihood
    work: Work = field(default_factory=Work)

    def grow(self, x: float, y: float, seed: int, free: Bools) -> Pole | None:
        """Pole near a place among free rays around the seed."""
        around = self.near.of(seed)
        self.work.looks += len(around)
        members, x, y, half = grow(self.model, x, y, around, free)
        return self._judge(np.sort(members), x, y, half, seed)

    def fit(self, members: Ints, x: float, y: float, seed: int) -> Pole | None:
        """Pole of given members, from a first place."""
        return self._judge(members, *settle(self.model, x, y, members), seed)

    def _judge(self, members: Ints, x: float, y: float, half: float, seed: int) -> Pole | None:
        if not np.isfinite(half):
            return None
        around = self.near.of(seed)
        self.work.looks += len(around)
        gain = evidence(self.model, x, y, half, members, around)
        return Pole(members, x, y, gain, seed) if gain > SETTLED else None

    def speaking(self, poles: list[Pole], rays: Ints) -> Floats:
        """What each ray (k,) adds to each pole (p,), against being a stray; -inf if it cannot."""
        places = np.array([(pole.x, pole.y) for pole in poles])
        return speaking(self.model, places, rays)

    def seeds(self) -> list[tuple[int, float, float]]:
        """Places where two rays meet, with the ray first; each ray's best partners."""
        who, place, tried = pair_seeds(self.model, self.near.start, self.near.ray, PARTNERS)
        self.work.pairs += tried
        ray, slot = np.nonzero(who >= 0)
        first, second = np.minimum(ray, who[ray, slot]), np.maximum(ray, who[ray, slot])
        _, once = np.unique(first * len(who) + second, return_index=True)
        ray, slot = ray[np.sort(once)], slot[np.sort(once)]
        return list(zip(ray.tolist(), *place[ray, slot].T.tolist(), strict=True))


def find_neighbours(rays: Rays, settings: TriangulationSettings) -> Neighbours:
    """Neighbours of every ray, those of one image together."""
    if not len(rays):
        return Neighbours(np.zeros(1, np.int64), np.empty(0, np.int64))
    reach_m = FURTHEST_CAMERAS * settings.max_distance_m
    pairs = cKDTree(rays.camera_m).query_pairs(reach_m, output_type="ndarray").astype(np.int64)
    own = np.arange(len(rays))
    first = np.concatenate([pairs[:, 0], pairs[:, 1], own])
    second = np.concatenate([pairs[:, 1], pairs[:, 0], own])
    order = np.lexsort([second, rays.image[second], first])
    start = np.searchsorted(first[order], np.arange(len(rays) + 1))
    return Neighbours(start, second[order])


def in_order(poles: Iterable[Pole]) -> list[Pole]:
    """Poles by their rays, so that no later step depends on how they were found."""
    return sorted(poles, key=lambda pole: pole.key)


def take_best(
    grower: Grower, seeds: list[tuple[int, float, float]], free: Bools
) -> tuple[list[Pole], list[Pole]]:
    """Hypotheses from seeds by falling gain; one that lost a ray to another is grown anew.

    Parameters
    ----------
    free : rays that may be used; those that are taken are struck out.

    Returns
    -------
    those taken, in order, and all that had a gain when they were grown, best first.
    """
    heap: list[tuple[float, tuple[int, ...], Pole]] = []
    known: set[tuple[int, ...]] = set()

    def push(pole: Pole | None) -> None:
        if pole is None or pole.key in known:
            return
        known.add(pole.key)
        heapq.heappush(heap, (-round(pole.gain, _DIGITS), pole.key, pole))

    for ray, x, y in seeds:
        push(grower.grow(x, y, ray, free))
    grown = [pole for _, _, pole in sorted(heap, key=lambda entry: entry[:2])]
    taken = []
    while heap:
        _, _, pole = heapq.heappop(heap)
        if free[pole.members].all():
            free[pole.members] = False
            taken.append(pole)
        else:
            push(grower.grow(pole.x, pole.y, pole.seed, free))
    return in_order(taken), grown


# Compiled loops of the association: what rays say about a place, and where they agree.


class Likelihood(NamedTuple):
    """What sightings of a pole look like, ray by ray, and what strays look like.

    Parameters
    ----------
    camera_m : (n, 2). direction : (n, 2), east and north of the bearings, unit length.
    image : (n,) whole numbers.
    angle_sigma, log_sigma : (n,) of bearing in radians and of the logarithm of distance.
    place_sigma : (n,) of the camera's place each axis, metres.
    log_depth : (n,) logarithm of the distance expected at the measured depth; NaN if unknown.
    stray : (n,) log density of the ray (per radian and per unit of log distance) as a stray.
    missed : log of the share of images that do not show a pole, by bins of `BIN_M` of its
        distance. odds : log of the share that do, less ``missed``.
    new_pole : log density of poles per square metre, less the evidence that is asked for.
    gate : largest chi squared of a member. reach_m : farthest distance.
    base_m : cameras of a pole's rays lie at least so far apart.
    """

    camera_m: Floats
    direction: Floats
    image: Ints
    angle_sigma: Floats
    log_sigma: Floats
    place_sigma: Floats
    log_depth: Floats
    stray: Floats
    missed: Floats
    odds: Floats
    new_pole: float
    gate: float
    reach_m: float
    base_m: float


NEAREST_M = 0.5  # a pole stands farther from a camera than this: the vehicle is in between
BIN_M = 4.0  # width of the bins of distance in which the share of images is counted
_STEPS = 4  # gauss-Newton steps of a place: the last moves it by millimetres
_GROWTHS = 4  # turns of choosing members and fitting the place; few groups change after the second
_LONGEST_M = 10.0  # longest step of a place: beyond, bearings are far from linear
_FLATTEST = 1e-14  # determinant of the normal matrix (1/m4) below which rays fix no place
_FIRST_GATE = 1.5  # the gate is this much wider before a place is fitted to its members
_PARALLEL = 1e-3  # sine of the angle between rays below which their crossing is nowhere
# Cosine of the angle (57 degrees) by which a ray may miss a place at all, whatever its sigma.
_LEAST_AHEAD = 0.54


@compiled()
def misfit(
    model: Likelihood, x: float, y: float, i: int, most: float
) -> tuple[float, float, float]:
    """Chi squared, log density and distance of ray i if its pole stands at a place.

    Chi squared is -1 where it exceeds ``most`` or the ray cannot show the place. Errors of the
    camera's place count by distance.
    """
    east, north = x - model.camera_m[i, 0], y - model.camera_m[i, 1]
    r2 = east * east + north * north
    r = np.sqrt(r2)
    # Most rays look elsewhere: what is cheap is asked first.
    ahead = east * model.direction[i, 0] + north * model.direction[i, 1]
    if r > model.reach_m or r < NEAREST_M or ahead < _LEAST_AHEAD * r:
        return -1.0, 0.0, r
    turn = np.arctan2(east * model.direction[i, 1] - north * model.direction[i, 0], ahead)
    place = model.place_sigma[i] ** 2 / r2
    across = model.angle_sigma[i] ** 2 + place
    chi2 = turn * turn / across
    if chi2 > most:
        return -1.0, 0.0, r
    if np.isnan(model.log_depth[i]):
        return chi2, -0.5 * (chi2 + np.log(2 * np.pi * across)), r
    along = model.log_sigma[i] ** 2 + place
    rest = 0.5 * np.log(r2) - model.log_depth[i]
    chi2 += rest * rest / along
    if chi2 > most:
        return -1.0, 0.0, r
    return chi2, -0.5 * (chi2 + np.log(4 * np.pi**2 * across * along)), r


@compiled()
def settle(model: Likelihood, x: float, y: float, members: Ints) -> tuple[float, float, float]:
    """Place of members by Gauss-Newton, and half the log determinant of its covariance.

    The last is infinite where the rays fix no place.
    """
    half = np.inf
    for _ in range(_STEPS):
        a = b = c = u = v = 0.0
        for i in members:
            east, north = x - model.camera_m[i, 0], y - model.camera_m[i, 1]
            r2 = max(east * east + north * north, NEAREST_M**2)
            ahead = east * model.direction[i, 0] + north * model.direction[i, 1]
            turn = np.arctan2(east * model.direction[i, 1] - north * model.direction[i, 0], ahead)
            place = model.place_sigma[i] ** 2 / r2
            w = 1.0 / (model.angle_sigma[i] ** 2 + place)
            jx, jy = north / r2, -east / r2
            a += w * jx * jx
            b += w * jx * jy
            c += w * jy * jy
            u += w * jx * turn
            v += w * jy * turn
            if not np.isnan(model.log_depth[i]):
                w = 1.0 / (model.log_sigma[i] ** 2 + place)
                jx, jy = east / r2, north / r2
                rest = 0.5 * np.log(r2) - model.log_depth[i]
                a += w * jx * jx
                b += w * jx * jy
                c += w * jy * jy
                u += w * jx * rest
                v += w * jy * rest
        det = a * c - b * b
        if det <= _FLATTEST:
            return x, y, np.inf
        half = -0.5 * np.log(det)
        dx, dy = (c * u - b * v) / det, (a * v - b * u) / det
        far = np.sqrt(dx * dx + dy * dy)
        if far > _LONGEST_M:
            dx, dy = dx * _LONGEST_M / far, dy * _LONGEST_M / far
        x, y = x - dx, y - dy
    return x, y, half


@compiled_part()
def bin_of(model: Likelihood, r: float) -> int:
    """Bin of a distance within reach."""
    return min(int(r / BIN_M), len(model.odds) - 1)


@compiled()
def speaks(model: Likelihood, x: float, y: float, i: int, widen: float) -> float:
    """What ray i adds to the log evidence of a pole at a place, against being a stray.

    Minus infinity beyond the gate, widened by a factor.
    """
    chi2, density, r = misfit(model, x, y, i, model.gate * widen)
    if chi2 < 0.0:
        return -np.inf
    return density - model.stray[i] + model.odds[bin_of(model, r)]


@compiled()
def choose(
    model: Likelihood, x: float, y: float, near: Ints, free: Bools, first: bool
) -> tuple[Ints, int]:
    """Of each image the free ray that speaks most for a place, if any; and how many they are.

    Parameters
    ----------
    near : rays, those of one image together. first : the place is rough: the gate is wider, and a
        ray within it counts even if it speaks against the place.
    """
    members, count, at = np.empty(len(near), np.int64), 0, 0
    while at < len(near):
        end, best, most = at, -1, 0.0
        while end < len(near) and model.image[near[end]] == model.image[near[at]]:
            i = near[end]
            end += 1
            if not free[i]:
                continue
            score = speaks(model, x, y, i, _FIRST_GATE if first else 1.0)
            if score > most or (first and best < 0 and score > -np.inf):
                best, most = i, score
        if best >= 0:
            members[count] = best
            count += 1
        at = end
    return members, count


@compiled()
def grow(
    model: Likelihood, x: float, y: float, near: Ints, free: Bools
) -> tuple[Ints, float, float, float]:
    """Members among free rays, place and half log determinant of a pole near a place.

    The last is infinite if there are not two members or they fix no place.
    """
    before = np.empty(0, np.int64)
    for turn in range(_GROWTHS):
        members, count = choose(model, x, y, near, free, turn == 0)
        if count < 2:
            return members[:count], x, y, np.inf
        same = count == len(before)
        if same:
            same = bool((members[:count] == before).all())
        if same:
            break
        before = members[:count].copy()
        x, y, half = settle(model, x, y, before)
        if half == np.inf:
            return before, x, y, half
    x, y, half = settle(model, x, y, before)
    return before, x, y, half


@compiled()
def evidence(
    model: Likelihood, x: float, y: float, half: float, members: Ints, near: Ints
) -> float:
    """Log evidence that members show one pole at their place, against all being strays.

    Minus infinity if a member lies beyond its gate by half, or all cameras are at one place.
    """
    total, spread = model.new_pole + np.log(2 * np.pi) + half, False
    for i in members:
        total += speaks(model, x, y, i, _FIRST_GATE)
        east = model.camera_m[i, 0] - model.camera_m[members[0], 0]
        north = model.camera_m[i, 1] - model.camera_m[members[0], 1]
        spread = spread or east * east + north * north >= model.base_m * model.base_m
    if not spread:
        return -np.inf
    last = -1
    for k in near:
        if model.image[k] != last:
            last = model.image[k]
            east, north = x - model.camera_m[k, 0], y - model.camera_m[k, 1]
            r = np.sqrt(east * east + north * north)
            if r <= model.reach_m:
                total += model.missed[bin_of(model, r)]
    return total


@compiled()
def pair_seeds(
    model: Likelihood, start: Ints, ray: Ints, partners: int
) -> tuple[Ints, Floats, int]:
    """For each ray the partners (n, partners) whose pairs fit best, the places (n, partners, 2).

    Returns also the number of pairs that were tried. Partners are -1 where there are fewer.
    """
    n = len(model.direction)
    who = np.full((n, partners), -1, np.int64)
    place = np.zeros((n, partners, 2))
    two, tried = np.empty(2, np.int64), 0
    for i in range(n):
        worth, held = np.full(partners, -np.inf), 0
        for j in ray[start[i] : start[i + 1]]:
            east = model.camera_m[j, 0] - model.camera_m[i, 0]
            north = model.camera_m[j, 1] - model.camera_m[i, 1]
            near = east * east + north * north < model.base_m * model.base_m
            if near or model.image[j] == model.image[i]:
                continue
            tried += 1
            x, y = _start(model, i, j)
            two[0], two[1] = min(i, j), max(i, j)
            x, y, half = settle(model, x, y, two)
            most = _FIRST_GATE * model.gate
            chi2, own, _ = misfit(model, x, y, i, most)
            other, others, _ = misfit(model, x, y, j, most)
            if half == np.inf or chi2 < 0 or other < 0 or chi2 + other > most:
                continue
            score = own + others + half - model.stray[i] - model.stray[j]
            slot = held
            if held == partners:
                slot = int(np.argmin(worth))
                if score <= worth[slot]:
                    continue
            else:
                held += 1
            worth[slot], who[i, slot] = score, j
            place[i, slot, 0], place[i, slot, 1] = x, y
    return who, place, tried


@compiled_part()
def _start(model: Likelihood, i: int, j: int) -> tuple[float, float]:
    """First place of a pair: where ray i's depth puts it, or the crossing where that is unknown."""
    distance = 0.5 * model.reach_m
    if not np.isnan(model.log_depth[i]):
        distance = np.exp(model.log_depth[i])
    else:
        here, there = model.direction[i], model.direction[j]
        sine = here[0] * there[1] - here[1] * there[0]
        if abs(sine) > _PARALLEL:
            east = model.camera_m[j, 0] - model.camera_m[i, 0]
            north = model.camera_m[j, 1] - model.camera_m[i, 1]
            distance = (east * there[1] - north * there[0]) / sine
            distance = min(max(distance, 1.0), model.reach_m)
    x = model.camera_m[i, 0] + distance * model.direction[i, 0]
    return x, model.camera_m[i, 1] + distance * model.direction[i, 1]


@compiled()
def speaking(model: Likelihood, places: Floats, rays: Ints) -> Floats:
    """What each ray (k,) adds to a pole at each place (p, 2); -inf if it cannot be its ray."""
    found = np.empty((len(places), len(rays)))
    for p in range(len(places)):
        for k in range(len(rays)):
            found[p, k] = speaks(model, places[p, 0], places[p, 1], rays[k], 1.0)
    return found
