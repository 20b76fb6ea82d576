"""Minimum-cost covers and best coverage for a budget, with proof."""

from roadsight.placement.cover.budget import maximise_coverage
from roadsight.placement.cover.problem import CoverProblem
from roadsight.placement.cover.result import Cover
from roadsight.placement.cover.solve import solve_cover_problem

__all__ = ["Cover", "CoverProblem", "maximise_coverage", "solve_cover_problem"]
