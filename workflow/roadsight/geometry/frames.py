"""The local frame of a site: metres from a float64 origin, x east, y north, z up.

Everything between ingest and the final writers is in this frame, so that float32 is safe and
units cannot be mixed. Native coordinates (the cloud's own CRS and units) appear only at the border.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats


@dataclass(frozen=True)
class Frame:
    """Similarity between native coordinates and local metres.

    ``local_m = (native - origin) * (unit_m, unit_m, vertical_unit_m)``

    Parameters
    ----------
    origin : native x, y, z of the local origin, native units.
    unit_m : metres in one horizontal native unit (0.3048 for feet).
    vertical_unit_m : metres in one vertical native unit.
    crs_wkt : CRS of the native coordinates as WKT 2, or None for a local system.
    """

    origin: tuple[float, float, float]
    unit_m: float = 1.0
    vertical_unit_m: float = 1.0
    crs_wkt: str | None = None

    @property
    def scale(self) -> Floats:
        """Metres in one native unit along x, y, z; shape (3,)."""
        return np.array([self.unit_m, self.unit_m, self.vertical_unit_m])

    def to_local(self, native: ArrayLike) -> Floats:
        """Native coordinates (..., 2 or 3) to local metres, float64."""
        xyz = np.asarray(native, dtype=np.float64)
        n = xyz.shape[-1]
        local = xyz - np.asarray(self.origin)[:n]
        local *= self.scale[:n]
        return local

    def to_native(self, local_m: ArrayLike) -> Floats:
        """Local metres (..., 2 or 3) to native coordinates, float64."""
        xyz = np.asarray(local_m, dtype=np.float64)
        n = xyz.shape[-1]
        return xyz / self.scale[:n] + np.asarray(self.origin)[:n]

    def to_dict(self) -> dict[str, Any]:
        """JSON content; `from_dict` reads it back."""
        return asdict(self) | {"origin": list(self.origin)}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Frame:
        """Frame from the content of ``scene/frame.json`` (other keys are ignored)."""
        x, y, z = content["origin"]
        return cls((x, y, z), content["unit_m"], content["vertical_unit_m"], content["crs_wkt"])
