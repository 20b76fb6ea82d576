"""Cameras of photographs with a known lens on real data, one data set at a time."""

from __future__ import annotations

import sys

from roadsight.evidence.truth.alignment import measure_alignment
from roadsight.stages.truth.truth_stage import measuring

main = measuring(measure_alignment, __doc__)


if __name__ == "__main__":
    sys.exit(main())
