"""What every room uses: errors, validation, sections of settings, YAML, array types, shards."""
