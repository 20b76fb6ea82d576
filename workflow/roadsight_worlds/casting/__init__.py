"""Exact surfaces and rays."""
