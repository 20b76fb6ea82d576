"""Frames of a videolog, their track and what a drive is like."""
