"""What all ways to solve share: problem, reductions, relaxation, cuts, deadline, result."""
