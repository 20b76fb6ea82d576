"""What several stages of the placement chapter share: inputs, choices, sight."""
