"""Candidates, sensors, virtual LiDAR, targets, detection, set cover, obstacles."""
