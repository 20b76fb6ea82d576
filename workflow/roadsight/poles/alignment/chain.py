"""A chain of Gaussian unknowns: what all but one of its members say about that one.

Every member has a prior, what it measured itself, and links with the next member. Messages run
along the chain once either way (Kalman filter and smoother in information form), so that a drive
of any length costs time and memory in proportion to its images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Floats


@dataclass(frozen=True)
class Normal:
    """Quadratic misfit x' A x / 2 - b' x; A may be singular.

    Attributes
    ----------
    matrix : A (k, k). right : b (k,).
    """

    matrix: Floats
    right: Floats

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.matrix + other.matrix, self.right + other.right)

    def times(self, weight: float) -> Normal:
        """The same, counted so many times."""
        return Normal(weight * self.matrix, weight * self.right)

    def least(self) -> tuple[Floats, Floats]:
        """Its minimum (k,) and the inverse (k, k) of its matrix."""
        covariance = np.linalg.inv(self.matrix)
        return covariance @ self.right, 0.5 * (covariance + covariance.T)


_Solved = tuple[Floats, Floats, Floats]


def others_say(
    priors: Sequence[Normal], own: Sequence[Normal], links: Sequence[Normal]
) -> list[Normal]:
    """For each member its prior and what the other members say: all but its own measurement.

    Parameters
    ----------
    priors, own : (n) of each member, (k, k). links : (n - 1) of each member with the next one,
        (2 k, 2 k).
    """
    ahead = _swept(priors, own, links)
    turned = [_swapped(link) for link in links[::-1]]
    back = _swept(priors[::-1], own[::-1], turned)[::-1]
    return [a + p + b for a, p, b in zip(ahead, priors, back, strict=True)]


def _swept(
    priors: Sequence[Normal], own: Sequence[Normal], links: Sequence[Normal]
) -> list[Normal]:
    """What those before each member say about it."""
    size = len(priors[0].right) if priors else 0
    said = [Normal(np.zeros((size, size)), np.zeros(size))] if priors else []
    for number, link in enumerate(links):
        here = said[-1] + priors[number] + own[number]
        matrix, right = link.matrix.copy(), link.right.copy()
        matrix[:size, :size] += here.matrix
        right[:size] += here.right
        said.append(eliminated(Normal(matrix, right), size)[0])
    return said


def solve_bordered(members: Sequence[Normal], links: Sequence[Normal], border: Normal) -> _Solved:
    """Least misfit of a chain whose members share some numbers, such as those of one camera.

    Members are eliminated one by one, then found from the last to the first.

    Parameters
    ----------
    members : (n) of each member's own k numbers, then the s shared ones, (k + s, k + s).
    links : (n - 1) of each member's, the next one's, and the shared ones, (2 k + s, 2 k + s).
    border : what is known of the shared numbers beforehand, (s, s).

    Returns
    -------
    members' numbers (n, k), shared ones (s,) and their covariance (s, s)
    """
    shared = len(border.right)
    size = len(members[0].right) - shared
    own = np.r_[:size, 2 * size : 2 * size + shared]
    rest = Normal(np.zeros_like(members[0].matrix), np.zeros_like(members[0].right))
    gains = []
    for member, link in zip(members, links, strict=False):
        matrix, right = link.matrix.copy(), link.right.copy()
        here = rest + member
        matrix[np.ix_(own, own)] += here.matrix
        right[own] += here.right
        rest, gain = eliminated(Normal(matrix, right), size)
        gains.append(gain)
    rest, gain = eliminated(rest + members[-1], size)
    common, covariance = (rest + border).least()
    found = [gain.right - gain.matrix @ common]
    for gain in gains[::-1]:
        found.append(gain.right - gain.matrix @ np.r_[found[-1], common])
    return np.array(found[::-1]), common, covariance


def eliminated(one: Normal, size: int) -> tuple[Normal, Normal]:
    """Misfit of what follows the first numbers, and these: ``right - matrix @`` what follows."""
    head, cross = one.matrix[:size, :size], one.matrix[:size, size:]
    both = np.column_stack([cross, one.right[:size]])
    solved = np.asarray(np.linalg.solve(head, both), np.float64)
    gain = Normal(solved[:, :-1], solved[:, -1])
    matrix = one.matrix[size:, size:] - cross.T @ gain.matrix
    right = one.right[size:] - cross.T @ gain.right
    return Normal(0.5 * (matrix + matrix.T), right), gain


def _swapped(link: Normal) -> Normal:
    half = len(link.right) // 2
    order = np.r_[half : 2 * half, :half]
    return Normal(link.matrix[np.ix_(order, order)], link.right[order])


def surprise(own: Normal, others: Normal) -> float:
    """Squared distance of what a member measured from what the others say, in sigmas."""
    mean, covariance = others.least()
    gap = own.right - own.matrix @ mean
    spread = own.matrix + own.matrix @ covariance @ own.matrix
    return float(gap @ np.linalg.pinv(spread, hermitian=True) @ gap)
