"""Settings that had another name or value, so that files of earlier versions are told the new one.

A key that is renamed gets a line here, and so does a word among a setting's values.
"""

from __future__ import annotations

# Former settings and what they are called now, by dotted path.
RENAMED = {"terrain_mesh.occlusion": "effects.terrain_occlusion"}
# Former values of settings, by dotted path. ``ours`` was the only method of this project's own.
RENAMED_VALUES = {"alignment.method": {"ours": "road"}}


def renamed(path: str, value: object = None) -> str:
    """Hint for a setting, or for a value of it, that has a new name; empty if there is none."""
    if path in RENAMED:
        return f"renamed to {RENAMED[path]}"
    if new := RENAMED_VALUES.get(path, {}).get(str(value)):
        return f"{value} is renamed to {new}"
    return ""
