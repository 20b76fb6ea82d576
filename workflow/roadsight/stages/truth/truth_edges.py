"""Road edges on real data, one data set at a time."""

from __future__ import annotations

import sys

from roadsight.evidence.truth.edges import measure_edges
from roadsight.stages.truth.truth_stage import measuring

main = measuring(measure_edges, __doc__)


if __name__ == "__main__":
    sys.exit(main())
