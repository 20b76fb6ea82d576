"""From a videolog without camera metadata and a LiDAR cloud to poles on the map."""
