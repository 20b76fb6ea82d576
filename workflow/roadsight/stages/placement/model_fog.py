"""What fog takes out of each sensor's beam."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from roadsight.io.records.atomic import write_json
from roadsight.placement.sensors.light import fog_extinction_per_m
from roadsight.stages.command import Command

log = logging.getLogger("model_fog")


def model_fog(visibility_m: float, wavelengths_nm: Sequence[str] = (), *, out: Path) -> None:
    """Write the extinction coefficient at each sensor's wavelength."""
    found = {}
    for entry in wavelengths_nm:
        name, _, wavelength_nm = entry.rpartition("=")
        found[name] = fog_extinction_per_m(visibility_m, float(wavelength_nm))
        log.info("%s in %g m of visibility: %.3g per m", name, visibility_m, found[name])
    write_json(out, {"extinction_per_m": found})


main = Command(model_fog)


if __name__ == "__main__":
    sys.exit(main())
