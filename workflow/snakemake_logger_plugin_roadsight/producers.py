"""Which rules make a file is looked up once a file, and not once for each job that reads it.

A shard's detections are read by the checks of coverage, each plan's cover and what follows it. For
every reader Snakemake compares the path with all the rules' outputs: an eighth of what a list of
20,000 jobs takes. The answer hangs on the path alone, as no rule is added once the index is made.
"""

from __future__ import annotations

from functools import lru_cache

from snakemake.output_index import OutputIndex


def remember_producers() -> None:
    """Let Snakemake's index of outputs keep its answers; call this before jobs are listed."""
    looked_up = getattr(OutputIndex, "match_producers", None)
    if looked_up is not None and not hasattr(looked_up, "cache_info"):
        OutputIndex.match_producers = lru_cache(maxsize=None)(looked_up)
