"""Plans as people write them: saved in the site file, and files to take away."""
