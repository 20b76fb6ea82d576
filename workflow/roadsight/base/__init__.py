"""What every room uses: errors, validation, sections of settings, YAML, array types, shards."""

SEED = 1  # of everything random, where nobody gives one
