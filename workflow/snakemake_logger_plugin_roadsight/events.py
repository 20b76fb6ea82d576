"""Events of a run as JSON objects, one a line of a file."""

import json
import time
from logging import WARNING, LogRecord
from pathlib import Path
from typing import Any

FIELDS = {
    "run_info": ("stats",),
    "job_info": ("jobid", "rule_name", "wildcards", "reason", "output", "log", "is_checkpoint"),
    "job_started": ("jobs",),
    "job_finished": ("job_id",),
    "job_error": ("jobid", "rule_name", "log"),
    "progress": ("done", "total"),
    "error": ("exception",),
}


def entry(record: LogRecord) -> dict[str, Any] | None:
    """What is kept of a record: its time, its event and that event's fields; None: nothing.

    Texts of errors and warnings are kept, too.
    """
    event = getattr(record, "event", None)
    name = "message" if event is None else str(event)
    if name not in FIELDS and (event is not None or record.levelno < WARNING):
        return None
    kept: dict[str, Any] = {"time": record.created, "event": name}
    kept |= {key: getattr(record, key, None) for key in FIELDS.get(name, ())}
    if name in ("error", "message"):
        kept["text"] = record.getMessage()
    return kept


class EventsFile:
    """A file to which events are appended."""

    def __init__(self, path: str) -> None:
        self._file = Path(path).open("a", encoding="utf-8")  # noqa: SIM115  # until `close`
        self._write({"time": time.time(), "event": "opened"})

    def take(self, record: LogRecord) -> None:
        """Write a record that says something of the run."""
        kept = entry(record)
        if kept is not None:
            self._write(kept)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, kept: dict[str, Any]) -> None:
        self._file.write(json.dumps(kept, default=_plain) + "\n")
        self._file.flush()


def _plain(value: Any) -> Any:
    return dict(value) if hasattr(value, "keys") else str(value)
