"""Which way to the pavement a cloud allows: one surface, or smooth ground by FPFH and k-means."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError

METHODS = ("auto", "surface", "published")  # Ways to the pavement, as the setting names them.
# Share of scans with a blind disc from which the cloud was scanned from a vehicle in it.
SURE_SCANS = 0.5
# One scan has no registration to level, but its blind disc alone is a weak sign of a road.
_FEWEST_SCANS = 2
FINEST_M = 0.2  # Smallest cell of the surface; where points are sparser its cells are wider.
# Cells of the surface that are held at once: 0.6 km2 at the finest. Each takes 300 bytes.
MOST_CELLS = 15_000_000
MOST_SHARPENED = 5_000_000  # The same where the surface only sharpens edges: 0.2 km2, 1.5 GB.


@dataclass(frozen=True)
class Choice:
    """A way to the pavement and why it is taken.

    Parameters
    ----------
    method : which way. why : half a sentence. measured, limit : what decided.
    """

    method: Literal["surface", "published"]
    why: str
    measured: float | None = None
    limit: float | None = None

    def told(self) -> Doubt:
        """As a note beside the answer."""
        names = {
            "surface": "the pavement is one surface that runs on until a kerb, grass or a wall",
            "published": "the pavement is smooth ground by FPFH and k-means",
        }
        text = f"{names[self.method]}: {self.why}"
        return Doubt("pavement_method", "note", text, self.measured, self.limit)


def fits_surface(extent_m: Sequence[float], most_cells: int = MOST_CELLS) -> bool:
    """Whether an extent (east, north, ... metres) is not too wide for one surface."""
    return round(extent_m[0] * extent_m[1] / FINEST_M**2) <= most_cells


def choose_method(stated: str, seeded: bool, profile: Mapping[str, Any]) -> Choice:
    """How the pavement is found.

    Parameters
    ----------
    stated : one of `METHODS`. seeded : whether places on the road are given.
    profile : content of ``scene/profile.json``: extent and scans count.

    Raises
    ------
    InputError : the surface is stated for a site that is too wide for it.
    """
    east_m, north_m = profile["extent_m"][:2]
    wide = not fits_surface(profile["extent_m"])
    if stated == "published":
        return Choice("published", "so stated (pavement.method)")
    if stated == "surface" or seeded:
        if wide:
            raise InputError(
                "the site is too wide for its road to be found as one surface",
                where="pavement.method" if stated == "surface" else "pavement.seeds",
                found=f"{east_m:.0f} m x {north_m:.0f} m",
                allowed=f"up to {MOST_CELLS * FINEST_M**2 / 1e6:.1f} km2",
                hint="give the site an extent, or set pavement.method: published",
            )
        why = "so stated (pavement.method)" if stated == "surface" else "seeds are given"
        return Choice("surface", why)
    scans = profile.get("scans", {"number": 1, "blind_share": 0.0})
    if scans["number"] < _FEWEST_SCANS:
        why = "the cloud does not tell scans apart (point_source_id)"
        return Choice("published", why, scans["number"], _FEWEST_SCANS)
    share = round(float(scans["blind_share"]), 3)
    if share < SURE_SCANS:
        why = "few scans show the blind disc below a scanner that drove on the road"
        return Choice("published", why, share, SURE_SCANS)
    if wide:
        why = "the site is too wide for one surface, in cells; give it an extent"
        return Choice("published", why, round(east_m * north_m / FINEST_M**2), MOST_CELLS)
    why = "scans are told apart and show the blind disc below their vehicle"
    return Choice("surface", why, share, SURE_SCANS)
