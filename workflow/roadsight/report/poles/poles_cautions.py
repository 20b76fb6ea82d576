"""What limits the worth of located poles."""

from __future__ import annotations

from typing import Any

import pandas as pd

from roadsight.report.poles.poles_layers import ACCEPTED, UNUSED
from roadsight.report.site.cautions import Caution
from roadsight.report.wording import counted, number, percent

_FEW_IMAGES = 20
"""Fewer images are warned of: most poles are then seen from few sides."""
_FEW_SIGHTINGS = 20
"""Fewer sightings are warned of."""
_FEW_CHECKED = 10
"""Fewer known poles are warned of: a mean over them says little."""
_LEAST_ALIGNED = 0.7
"""A smaller share of aligned images is warned of."""
_WIDE_SIGMA_M = 5.0
"""Poles with a longer major half axis (one sigma) count as uncertain."""
_WIDE_SHARE = 0.2
"""A larger share of uncertain poles is warned of."""


def pole_cautions(
    cameras: pd.DataFrame,
    sightings: pd.DataFrame,
    poles: list[dict[str, Any]],
    validation: dict[str, Any] | None,
) -> list[Caution]:
    """Warnings first, then notes.

    Parameters
    ----------
    cameras : of `cameras_of`. sightings : with kept. poles : of `pole_records`.
    validation : content of validation.json.
    """
    warnings = _image_warnings(cameras) + _result_warnings(sightings, poles)
    notes = []
    if validation is None:
        notes.append("No known poles for this site: errors and scores are not known here.")
    else:
        checked = len(validation.get("errors", []))
        own = [_sentence(str(text)) for text in validation.get("warnings", [])]
        if checked < _FEW_CHECKED and not any(text.startswith("Only") for text in own):
            warnings.append(
                f"Only {counted(checked, 'pole')} could be checked against known ones: mean errors"
                " and scores rest on little data."
            )
        warnings += own
    unused = int((cameras["state"] == UNUSED).sum())
    if unused:
        notes.append(f"{counted(unused, 'image')} not used; the map says why.")
    notes.append(
        "Error ellipses come from the sightings' own uncertainties: an error that a whole route"
        " shares does not show in them."
    )
    return [Caution("warning", text) for text in warnings] + [Caution("note", t) for t in notes]


def _image_warnings(cameras: pd.DataFrame) -> list[str]:
    used = int((cameras["state"] != UNUSED).sum())
    aligned = int((cameras["state"] == ACCEPTED).sum())
    found = []
    if used < _FEW_IMAGES:
        found.append(f"Only {counted(used, 'image')}: most poles are seen from few sides.")
    if aligned < _LEAST_ALIGNED * used:
        found.append(
            f"Only {number(aligned)} of {counted(used, 'image')} ({percent(aligned / used)}) could"
            " be aligned with the LiDAR road edge: poles beside the others are missing or rest on"
            " fewer images."
        )
    return found


def _result_warnings(sightings: pd.DataFrame, poles: list[dict[str, Any]]) -> list[str]:
    kept = int(sightings["kept"].sum())
    found = []
    if kept < _FEW_SIGHTINGS:
        found.append(f"Only {counted(kept, 'sighting')} of poles: little to triangulate from.")
    if not poles:
        return [*found, "No pole was located."]
    wide = sum((pole["sigma_major_m"] or 0.0) > _WIDE_SIGMA_M for pole in poles)
    if wide > _WIDE_SHARE * len(poles):
        found.append(
            f"{number(wide)} of {counted(len(poles), 'pole')} may be off by more than"
            f" {number(_WIDE_SIGMA_M)} m (one sigma along the longer axis)."
        )
    return found


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."
