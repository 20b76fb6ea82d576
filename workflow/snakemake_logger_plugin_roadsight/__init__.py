"""Snakemake's logger plugin ``roadsight``: what a run does, as one JSON object a line.

``snakemake --logger roadsight --logger-roadsight-events FILE`` appends to FILE; the usual output
stays. The studio reads the plan of a dry run and the progress of a run from such files.
"""

import json
import time
from dataclasses import dataclass, field
from logging import WARNING, LogRecord
from pathlib import Path
from typing import Any, Optional

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.settings import LogHandlerSettingsBase

FIELDS = {
    "run_info": ("stats",),
    "job_info": ("jobid", "rule_name", "wildcards", "reason", "output", "log", "is_checkpoint"),
    "job_started": ("jobs",),
    "job_finished": ("job_id",),
    "job_error": ("jobid", "rule_name", "log"),
    "progress": ("done", "total"),
    "error": ("exception",),
}


@dataclass
class LogHandlerSettings(LogHandlerSettingsBase):
    """Options of the plugin."""

    events: Optional[str] = field(  # noqa: UP045  # Snakemake reads this very form
        default=None, metadata={"help": "File to which events are appended", "required": True}
    )


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


class LogHandler(LogHandlerBase):
    """Appends events to the file."""

    def __post_init__(self) -> None:
        """Open the file."""
        assert isinstance(self.settings, LogHandlerSettings)
        assert self.settings.events is not None
        self._file = Path(self.settings.events).open("a", encoding="utf-8")  # noqa: SIM115  # until `close`
        self._write({"time": time.time(), "event": "opened"})

    def emit(self, record: LogRecord) -> None:
        """Write a record that says something of the run."""
        kept = entry(record)
        if kept is not None:
            self._write(kept)

    def _write(self, kept: dict[str, Any]) -> None:
        self._file.write(json.dumps(kept, default=_plain) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()

    @property
    def writes_to_stream(self) -> bool:
        """No: the usual output stays."""
        return False

    @property
    def writes_to_file(self) -> bool:
        """Not a log that Snakemake would mention at its end."""
        return False

    @property
    def has_filter(self) -> bool:
        """Records are chosen here."""
        return True

    @property
    def has_formatter(self) -> bool:
        """Records are written here."""
        return True

    @property
    def needs_rulegraph(self) -> bool:
        """No."""
        return False


def _plain(value: Any) -> Any:
    return dict(value) if hasattr(value, "keys") else str(value)
