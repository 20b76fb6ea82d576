"""What the writer of a cloud knew beside its points, carried into the clouds that verbs write."""

from __future__ import annotations

from dataclasses import dataclass, field

import laspy
import numpy as np
from numpy.typing import NDArray

_OWN = ("LASF_Projection", "laszip encoded", "copc", "lascompatible")
"""Records that are written anew (CRS, compression) or hold for one order of the points only."""
_SPEC = "LASF_Spec"
_EXTRA_BYTES, _SUPERSEDED, _WAVE_FIRST, _WAVE_LAST, _WAVE_DATA = 4, 7, 100, 354, 65535
"""Numbers of records of the specification that belong to fields which are described anew, and to
waveforms, which are not read."""
_LONGEST_RECORD = 65535
"""Bytes of an ordinary record; longer ones are extended."""


@dataclass(frozen=True)
class ExtraField:
    """Description of an extra dimension: scales and offsets (k,) and the type of what is stored.

    All three are None where values are stored as they are.
    """

    description: str = ""
    dtype: np.dtype | None = None
    scales: NDArray[np.float64] | None = None
    offsets: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Carried:
    """Header fields and records of a cloud that do not depend on what a verb changes.

    Parameters
    ----------
    time_type : bit of the global encoding: 0 GPS week time, 1 adjusted standard GPS time.
    file_source_id, system_identifier : as in the header.
    records : user id, number, description and content of each record that is kept.
    extra : description of each extra dimension by name.
    """

    time_type: int = 0
    file_source_id: int = 0
    system_identifier: str = ""
    records: tuple[tuple[str, int, str, bytes], ...] = ()
    extra: dict[str, ExtraField] = field(default_factory=dict)


def carried_of(header: laspy.LasHeader) -> Carried:
    """What is carried of a header."""
    system = header.system_identifier
    text = system.decode("ascii", "replace") if isinstance(system, bytes) else str(system)
    records = [
        (record.user_id, record.record_id, record.description, record.record_data_bytes())
        for record in [*header.vlrs, *(header.evlrs or [])]
        if _is_kept(record.user_id, record.record_id)
    ]
    extra = {dim.name: _extra_field(dim) for dim in header.point_format.extra_dimensions}
    return Carried(
        int(header.global_encoding.gps_time_type),
        int(header.file_source_id),
        text.rstrip("\0 "),
        tuple(records),
        extra,
    )


def _extra_field(dim: laspy.DimensionInfo) -> ExtraField:
    if dim.scales is None:
        return ExtraField(dim.description)
    stored = dim.dtype.base if dim.dtype is not None else None
    return ExtraField(dim.description, stored, dim.scales, dim.offsets)


def _is_kept(user: str, number: int) -> bool:
    if user.rstrip("\0") in _OWN:
        return False
    waves = _WAVE_FIRST <= number <= _WAVE_LAST or number == _WAVE_DATA
    return user.rstrip("\0") != _SPEC or not (waves or number in (_EXTRA_BYTES, _SUPERSEDED))


def carry(header: laspy.LasHeader, carried: Carried) -> None:
    """Put what is carried into a new header."""
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType(carried.time_type)
    header.file_source_id = carried.file_source_id
    if carried.system_identifier:
        header.system_identifier = carried.system_identifier
    for user, number, description, content in carried.records:
        record = laspy.VLR(user, number, _text(description), content)
        if len(content) > _LONGEST_RECORD:
            if header.evlrs is None:
                header.evlrs = laspy.vlrs.vlrlist.VLRList()
            header.evlrs.append(record)
        else:
            header.vlrs.append(record)


def _text(description: str | bytes) -> str:
    plain = (
        description.decode("ascii", "replace") if isinstance(description, bytes) else description
    )
    return plain.rstrip("\0")
