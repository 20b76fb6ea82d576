"""What the images of a drive share: lens, mount, side views."""
