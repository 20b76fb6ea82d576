"""Training of the project's own small networks on rendered roads (docs/poles/training.md)."""
