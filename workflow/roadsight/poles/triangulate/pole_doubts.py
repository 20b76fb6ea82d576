"""What located poles rest on, beside the errors that are stated of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from roadsight.base.doubts import Doubt, Severity
from roadsight.poles.sightings.metric_depth import NetworkScale
from roadsight.poles.triangulate.rays import TriangulationSettings
from roadsight.poles.triangulate.withhold import UNDER_CROWN

# Share of sightings that end at a column of the cloud below which it shows no poles. With columns
# it is half or more.
LEAST_ANCHORED = 0.1
# The same share below which far sightings count and stated errors are doubted. On the generated
# rural road 0.51 to 0.59 of the sightings end at a column at 24 pulses/m2; at 8 it is 0.25, at 2
# 0.04, where the ellipses for 95 % hold 91 % of the poles of twelve roads, and 63 and 71 % on two
# of which one drive each is off by three and more of its sigmas.
FEW_ANCHORED = 0.4
# Where a cloud has no returns on poles, far sightings are all there is of some: on the generated
# rural road 28 of 30 poles are found with this and 24 with 40 m, and without side views, as a
# camera of 20 degrees sees a pole from no nearer than 30 m, 22 and 4. Where it has, far rays add
# groups of other things: 6 beside 31.
FAR_M = 60.0
# Longest error ellipse of a pole that may rest on far rays: on that road at 8 pulses/m2, once what
# stands under crowns is left out, 28 of 30 poles and nothing else stay with this, 27 with 0.75 m,
# 28 and 2 other things with the usual 5 m.
FAR_SIGMA_M = 1.0
# Reason why a sighting is left out: a side view at a guessed yaw gives bearings that are off by as
# much as the guess is.
UNTURNED = "yaw of the side view not found"
_LARGE = 0.2  # logarithm of a network's scale from which it is a doubt: a fifth of the distance


def anchored_share(sightings: pd.DataFrame) -> float:
    """Share of the kept sightings that end at something of the cloud; 1 without any.

    Parameters
    ----------
    sightings : columns kept and anchored.
    """
    kept = sightings["kept"].to_numpy(bool)
    return float(sightings["anchored"].to_numpy(bool)[kept].mean()) if kept.any() else 1.0


def far_reaching(
    sightings: pd.DataFrame, settings: TriangulationSettings, most_m: float = FAR_SIGMA_M
) -> TriangulationSettings:
    """Settings by which far sightings count too, where the cloud shows few poles.

    Their groups are more often of other things, so that a pole must be told more sharply, to
    ``most_m``.
    """
    if anchored_share(sightings) >= FEW_ANCHORED or settings.max_distance_m >= FAR_M:
        return settings
    sharp_m = min(settings.max_sigma_m, most_m)
    return settings.model_copy(update={"max_distance_m": FAR_M, "max_sigma_m": sharp_m})


def network_doubts(own: Sequence[str]) -> list[Doubt]:
    """Doubts where the project's ``own`` networks, of classes or depth, read photographs."""
    if not own:
        return []
    text = (
        "images are read by the project's own networks, which were trained on rendered roads and"
        " never saw a photograph (of pole pixels on photographs they overlap the true ones by"
        " 0.06): name networks that did in poles.masks and poles.depth (docs/poles/models.md)"
    )
    return [Doubt("networks_saw_no_photograph", "doubt", text, " and ".join(own), None)]


def crown_doubts(poles: pd.DataFrame) -> list[Doubt]:
    """Note on poles that were withheld as trunks, see `withhold_under_crowns`."""
    withheld = int((poles["reason"] == UNDER_CROWN).sum())
    if not withheld:
        return []
    text = (
        "stand under a crown and not clearly in the cloud, and are withheld as trunks; a lamp among"
        " branches would be one of them (poles.decisions accepts it): poles withheld so"
    )
    return [Doubt("under_crowns", "note", text, withheld)]


def pole_doubts(
    sightings: pd.DataFrame, network: Sequence[NetworkScale], settings: TriangulationSettings
) -> list[Doubt]:
    """Doubts about the poles of a site.

    Parameters
    ----------
    sightings : columns kept, kind, anchored, reason; the cloud is asked for poles alone.
    network : cameras whose network was scaled.
    settings : by which they are triangulated, see `far_reaching`.
    """
    found = []
    for one in network:
        text = (
            f"route {one.route}, {one.view} view: distances of the depth network over those of"
            f" {one.pairs} feet on the ground, by which they are divided"
        )
        severity: Severity = "doubt" if abs(np.log(one.ratio)) > _LARGE else "note"
        found.append(Doubt("network_scale", severity, text, round(one.ratio, 3)))
    # The published sweep takes nothing from the cloud and states no errors.
    evident = settings.method != "sweep"
    share = anchored_share(sightings[sightings["kind"] == "pole"]) if evident else 1.0
    if share < LEAST_ANCHORED:
        text = (
            "the cloud shows next to no poles, so that their places rest on rays alone (a denser"
            " survey places them better): share of sightings that end at one"
        )
        found.append(Doubt("poles_not_in_cloud", "doubt", text, round(share, 3), LEAST_ANCHORED))
    if share < FEW_ANCHORED:
        text = (
            "few poles show in the cloud, so that sightings up to"
            f" {settings.max_distance_m:g} m count, what is not known to {settings.max_sigma_m:g} m"
            " is withheld, and errors that a whole drive shares can be larger than"
            " stated (a denser survey mends that): share of sightings that end at a pole of it"
        )
        found.append(Doubt("sigmas_too_small", "doubt", text, round(share, 3), FEW_ANCHORED))
    lost = int((sightings["reason"] == UNTURNED).sum())
    if lost:
        text = (
            "nothing tells the yaw of side views (give sightings.left_yaw_deg, right_yaw_deg and"
            " side_views: given, if it is known): sightings left out"
        )
        found.append(Doubt("side_views_left_out", "doubt", text, lost, 0))
    return found
