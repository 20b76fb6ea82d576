"""The seed of everything random, where nobody gives one."""

from __future__ import annotations

SEED = 1
