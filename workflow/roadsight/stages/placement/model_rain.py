"""What rain takes out of a beam."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from roadsight.io.records.atomic import write_json
from roadsight.placement.sensors.light import rain_extinction_per_m
from roadsight.stages.command import Command

log = logging.getLogger("model_rain")


def model_rain(
    rain_mm_h: float, sensors: Annotated[Sequence[str], "names of the sensors"] = (), *, out: Path
) -> None:
    """Write the extinction coefficient; it is the same for all sensors."""
    extinction = rain_extinction_per_m(rain_mm_h)
    log.info("%g mm/h of rain: %.3g per m", rain_mm_h, extinction)
    write_json(out, {"extinction_per_m": dict.fromkeys(sensors, extinction)})


main = Command(model_rain)


if __name__ == "__main__":
    sys.exit(main())
