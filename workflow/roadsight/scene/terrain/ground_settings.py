"""Settings of the ground filter, and what follows from them."""

from __future__ import annotations

from math import ceil

from roadsight.base.sections.scene import GroundFilter

# Natural ground departs from a plane by about this share of the distance between points; measured
# on ISPRS filter samples.
ROUGHNESS_PER_SPACING = 0.2
# Half width of the window of pillars that a pillar is compared with; measured on street scans.
_AROUND_M = 1.1
# A thick layer that goes on so far to all sides is noise and not a hedge; street scans lose 0.06 of
# F1 with half of it. The noise around a hedge is compared as far.
_STEADY_M = 2.0
# What stands in no more pillars than such a trunk and one around is no hedge: around posts and
# trunks on rough grass beside a smooth road, 36 to 78 % of the ground would be lost. F1 of street
# scans is 96.1 with it, 96.2 without, 96.0 with twice of it.
_TRUNK_M = 0.5
_AVERAGED_PILLARS = 5  # Pillars beyond that window that averages reach.


def ground_settings_for(spacing_m: float, settings: GroundFilter) -> GroundFilter:
    """Settings for a cloud: coarse cells a third of the spacing wide where that is more.

    Nothing else follows a number for the whole cloud; this one bounds the memory of clouds with
    less than a point in nine square metres. Published pillars are as wide as the spacing where that
    is more (paper 1, section 3.2: no value for the TMA lower than Table 2's spacing).
    """
    update = {"coarse_cell_m": max(settings.coarse_cell_m, spacing_m / 3)}
    if settings.method == "pillars":
        update["pillar_width_m"] = max(settings.pillar_width_m, spacing_m)
    return settings.model_copy(update=update)


def reach_m(settings: GroundFilter) -> float:
    """How far away a point may matter to the label of another: the halo of a tile."""
    if settings.method == "pillars":
        return settings.pillar_width_m
    widest = max(pillar_reach_m(width) for width in pillar_widths_m(settings))
    return widest + 2 * settings.coarse_cell_m


def around_pillars(width_m: float) -> int:
    """Half width of the window of pillars around one, in pillars."""
    return max(2, round(_AROUND_M / width_m))


def steady_pillars(width_m: float) -> int:
    """Half width of the window in which a thick layer must go on, in pillars."""
    return max(1, round(_STEADY_M / width_m))


def hedge_pillars(width_m: float) -> int:
    """Pillars across the narrowest hedge."""
    return ceil(_TRUNK_M / width_m) + 1


def pillar_reach_m(width_m: float) -> float:
    """How far pillars of one width look: the window around, twice, and averages.

    The noise is measured over that window, again where it goes on, and then once more, and compared
    with that of the pillars so far away, over the width of a hedge.
    """
    far = steady_pillars(width_m)
    compared = far + hedge_pillars(width_m)
    pillars = 2 * around_pillars(width_m) + far + max(compared, _AVERAGED_PILLARS)
    return pillars * width_m


def pillar_widths_m(settings: GroundFilter) -> tuple[float, ...]:
    """Widths of pillars, doubled as long as they are less than a coarse cell."""
    widths = [settings.pillar_width_m]
    while 2 * widths[-1] < settings.coarse_cell_m:
        widths.append(2 * widths[-1])
    return tuple(widths)
