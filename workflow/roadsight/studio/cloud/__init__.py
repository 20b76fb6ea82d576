"""The cloud in the browser."""
