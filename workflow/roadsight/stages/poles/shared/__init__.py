"""What several stages of the pole job share: inputs and layers."""
