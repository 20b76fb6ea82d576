"""Virtual LiDAR: depth maps of the scene from a candidate."""
