"""Ground labels on real data, one data set at a time."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from roadsight.evidence.truth.ground import measure_ground
from roadsight.stages.truth.truth_stage import truth_main


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    return truth_main(__doc__, measure_ground, argv)


if __name__ == "__main__":
    sys.exit(main())
