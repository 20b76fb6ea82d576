"""What rain takes out of a beam."""

from __future__ import annotations

import argparse
import logging
import sys

from roadsight.io.records.atomic import write_json
from roadsight.placement.sensors.light import rain_extinction_per_m
from roadsight.stages.command import run_stage

log = logging.getLogger("model_rain")


def model_rain(arguments: argparse.Namespace) -> None:
    """Write the extinction coefficient; it is the same for all sensors."""
    extinction = rain_extinction_per_m(arguments.rain_mm_h)
    log.info("%g mm/h of rain: %.3g per m", arguments.rain_mm_h, extinction)
    write_json(arguments.out, {"extinction_per_m": dict.fromkeys(arguments.sensors, extinction)})


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rain-mm-h", type=float, required=True)
    parser.add_argument("--sensors", nargs="*", required=True, help="names of the sensors")
    parser.add_argument("--out", required=True)
    return run_stage(parser, model_rain, argv)


if __name__ == "__main__":
    sys.exit(main())
