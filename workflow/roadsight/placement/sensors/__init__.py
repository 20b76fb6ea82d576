"""Kinds of sensors: channels, fields of view, poses, beams, range."""
