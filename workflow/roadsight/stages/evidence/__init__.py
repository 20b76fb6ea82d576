"""Stages that measure, audit, sum up and report."""
