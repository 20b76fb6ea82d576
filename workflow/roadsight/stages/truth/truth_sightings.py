"""Poles from published sightings on real data, one data set at a time."""

from __future__ import annotations

import sys

from roadsight.evidence.truth.sightings import measure_sightings
from roadsight.stages.truth.truth_stage import measuring

main = measuring(measure_sightings, __doc__)


if __name__ == "__main__":
    sys.exit(main())
