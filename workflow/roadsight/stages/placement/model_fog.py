"""What fog takes out of each sensor's beam."""

from __future__ import annotations

import argparse
import logging
import sys

from roadsight.io.records.atomic import write_json
from roadsight.placement.sensors.light import fog_extinction_per_m
from roadsight.stages.command import run_stage

log = logging.getLogger("model_fog")


def model_fog(arguments: argparse.Namespace) -> None:
    """Write the extinction coefficient at each sensor's wavelength."""
    found = {}
    for entry in arguments.wavelengths_nm:
        name, _, wavelength_nm = entry.rpartition("=")
        found[name] = fog_extinction_per_m(arguments.visibility_m, float(wavelength_nm))
        log.info("%s in %g m of visibility: %.3g per m", name, arguments.visibility_m, found[name])
    write_json(arguments.out, {"extinction_per_m": found})


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--visibility-m", type=float, required=True)
    parser.add_argument("--wavelengths-nm", nargs="*", required=True, metavar="SENSOR=NM")
    parser.add_argument("--out", required=True)
    return run_stage(parser, model_fog, argv)


if __name__ == "__main__":
    sys.exit(main())
