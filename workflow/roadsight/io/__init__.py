"""The only code that opens files: clouds, rasters, vectors, tables, shards; atomic writes."""
