"""Cost of each step of the site that the studies of one job start from, run once more."""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys

from roadsight.evidence.base_costs import base_costs
from roadsight.evidence.tradeoffs import NOT_OF_THE_JOB
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import write_json
from roadsight.stages.command import run_stage

log = logging.getLogger("measure_base")

# Forcing the checkpoint would have Snakemake plan everything anew. These compile no kernels.
_UP_TO_THE_CHECKPOINT = {"ingest_cloud", "profile_scene"}


def measure_base(arguments: argparse.Namespace) -> None:
    """Run every step again in a folder of its own and write the first and the cheapest costs."""
    config = json.loads(arguments.config)
    variant = Variant.prepare(".", arguments.work, config, arguments.site, {})
    records = variant.records(arguments.targets)
    left_out = NOT_OF_THE_JOB | _UP_TO_THE_CHECKPOINT
    jobs = [record for record in records if record.rule not in left_out]
    again = variant.repeat(arguments.targets, jobs, arguments.repeats - 1, arguments.cores)
    write_json(arguments.out, base_costs([jobs, *again]))
    shutil.rmtree(variant.folder)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", required=True)
    parser.add_argument("--config", required=True, help="whole configuration, JSON")
    parser.add_argument("--targets", nargs="+", required=True, help="below results/<site>")
    parser.add_argument("--repeats", type=int, default=2, help="timings, the base's own included")
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--work", required=True, help="folder to work in, deleted afterwards")
    parser.add_argument("--out", required=True)
    return run_stage(parser, measure_base, argv)


if __name__ == "__main__":
    sys.exit(main())
