"""Minimum-cost covers and best coverage for a budget, with proof."""

from roadsight.setcover.common.problem import Cover, CoverProblem
from roadsight.setcover.cover.solve import solve_cover_problem
from roadsight.setcover.plans.curve import maximise_coverage

__all__ = ["Cover", "CoverProblem", "maximise_coverage", "solve_cover_problem"]
