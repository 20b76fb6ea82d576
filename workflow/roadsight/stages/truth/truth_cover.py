"""Public covering instances on real data, one data set at a time."""

from __future__ import annotations

import sys

from roadsight.evidence.truth.cover import measure_cover
from roadsight.stages.truth.truth_stage import measuring

main = measuring(measure_cover, __doc__)


if __name__ == "__main__":
    sys.exit(main())
