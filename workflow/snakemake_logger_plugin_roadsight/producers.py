"""Which rules make a file is looked up once a file, and not once for each job that reads it.

A shard's detections are read by the checks of coverage, each plan's cover and what follows it. For
every reader Snakemake compares the path with all the rules' outputs: an eighth of what a list of
20,000 jobs takes. The answer hangs on the path alone, as no rule is added once the index is made.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from snakemake.output_index import OutputIndex

from snakemake_logger_plugin_roadsight.patching import replace_method

_EXPECTED = """
def match_producers(self, targetfile: str) -> set[Rule]:
    return {rule for rule in self.match(targetfile) if rule.is_producer(targetfile)}
"""


@cache
def match_producers(index: Any, path: str) -> set[Any]:
    """Rules that produce a file, looked up once."""
    return {rule for rule in index.match(path) if rule.is_producer(path)}


def remember_producers() -> None:
    """Let Snakemake's index of outputs keep its answers; call this before jobs are listed."""
    without = "long lists of jobs take an eighth longer"
    replace_method(OutputIndex, "match_producers", _EXPECTED, match_producers, without)
