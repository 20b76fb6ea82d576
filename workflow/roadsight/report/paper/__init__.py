"""The report on paper: maps at a true scale, a still of the cloud, and what the pages say."""
