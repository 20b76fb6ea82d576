"""Cost of each step of the site that the studies of one job start from, run once more."""

from __future__ import annotations

import json
import logging
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from roadsight.evidence.costs import base_costs
from roadsight.evidence.tradeoffs import NOT_OF_THE_JOB
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import write_json
from roadsight.stages.command import Command

log = logging.getLogger("measure_base")

# Forcing the checkpoint would have Snakemake plan everything anew. These compile no kernels.
_UP_TO_THE_CHECKPOINT = {"ingest_cloud", "profile_scene"}


def measure_base(
    site: str,
    config_json: Annotated[str, "whole configuration, JSON"],
    targets: Annotated[Sequence[str], "below results/<site>"],
    work: Annotated[str, "folder to work in, deleted afterwards"],
    repeats: Annotated[int, "timings, the base's own included"] = 2,
    cores: int = 1,
    *,
    out: Path,
) -> None:
    """Run every step again in a folder of its own and write the first and the cheapest costs."""
    config = json.loads(config_json)
    variant = Variant.prepare(".", work, config, site, {})
    records = variant.records(targets)
    left_out = NOT_OF_THE_JOB | _UP_TO_THE_CHECKPOINT
    jobs = [record for record in records if record.rule not in left_out]
    again = variant.repeat(targets, jobs, repeats - 1, cores)
    write_json(out, base_costs([jobs, *again]))
    shutil.rmtree(variant.folder)


main = Command(measure_base)


if __name__ == "__main__":
    sys.exit(main())
