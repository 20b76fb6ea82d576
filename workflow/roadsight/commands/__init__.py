"""Verbs of the ``roadsight`` command: single pieces of the workflow on one's own files."""
