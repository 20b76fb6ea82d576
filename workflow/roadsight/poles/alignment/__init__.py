"""Camera poses by aligning road edges of the LiDAR with road edges of the image."""
