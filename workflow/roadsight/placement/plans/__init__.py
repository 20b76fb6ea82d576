"""From what a plan asks for to its answer."""
