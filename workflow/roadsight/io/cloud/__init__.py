"""LAS and LAZ files, and the tiles of a site."""
