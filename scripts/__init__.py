"""Chores of the project: the machine check, the plan of the rooms."""
