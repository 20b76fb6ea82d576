"""Snakemake's logger plugin ``roadsight``: what a run says to people, and to the studio.

``snakemake --logger roadsight``, as the default profile has it, writes one line a step, with its
site, the progress and the time that is left. With ``--verbose``, ``--printshellcmds``,
``--debug-dag`` or ``--dry-run`` Snakemake speaks for itself.

With ``--logger-roadsight-events FILE`` events are appended to FILE, one JSON object a line, and the
usual output stays. The studio reads the plan of a dry run and the progress of a run from there.
"""

import sys
from dataclasses import dataclass, field
from logging import WARNING, LogRecord
from typing import Any, Optional

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent
from snakemake_interface_logger_plugins.settings import LogHandlerSettingsBase

from snakemake_logger_plugin_roadsight.events import EventsFile
from snakemake_logger_plugin_roadsight.lines import Steps

_SAID = {LogEvent.GROUP_ERROR, LogEvent.ERROR}
"""Events that are said as Snakemake says them; of the others, some become lines."""
_AGAIN = ("CalledProcessError in file", "At least one job did not complete successfully")
"""What Snakemake says once more of a step that failed, with its whole command."""
_END = "Exiting because a job execution failed"
_CHATTER = (
    "Building DAG",
    "Using shell",
    "Provided ",
    "Rules claiming",
    "Assuming ",
    "Config file",
    "host: ",
)
"""Beginnings of plain messages before a run that tell its reader nothing. All others are kept until
a run begins: they are what --lint, --unlock and their like have to say."""


@dataclass
class LogHandlerSettings(LogHandlerSettingsBase):
    """Options of the plugin."""

    events: Optional[str] = field(  # noqa: UP045  # Snakemake reads this very form
        default=None, metadata={"help": "File to which events are appended"}
    )


class LogHandler(LogHandlerBase):
    """Writes lines to stderr, or events to a file."""

    def __post_init__(self) -> None:
        """Begin without steps; open the file of events, if one is named."""
        path = getattr(self.settings, "events", None)
        self._events = None if path is None else EventsFile(path)
        self._now_s = 0.0
        self._runs = False
        self._steps = Steps(lambda: self._now_s)

    def emit(self, record: LogRecord) -> None:
        """Write what a record means, if it means anything."""
        if self._events is not None:
            self._events.take(record)
        elif self.writes_to_stream:
            lines = self._lines(record)
            sys.stderr.write("".join(f"{line}\n" for line in lines))
            sys.stderr.flush()

    def _lines(self, record: LogRecord) -> list[str]:
        self._now_s = record.created
        event = getattr(record, "event", None)
        about: dict[str, Any] = vars(record)
        if event in _SAID or (event is None and record.levelno >= WARNING):
            return self._trouble(self.format(record))
        if event is None:
            text = record.getMessage()
            return [] if self._runs or text.startswith(_CHATTER) else [text]
        if event == LogEvent.RUN_INFO:
            self._runs = True
            return self._steps.planned(about["stats"])
        if event == LogEvent.PROGRESS:
            return self._steps.progressed(about["done"], about["total"])
        if event == LogEvent.JOB_ERROR:
            return self._steps.failed(about["jobid"], about["rule_name"], about["log"])
        if event == LogEvent.JOB_INFO:
            self._steps.named(about["jobid"], about["rule_name"], about["wildcards"] or {})
        elif event == LogEvent.JOB_STARTED:
            self._steps.started(about["jobs"])
        elif event == LogEvent.JOB_FINISHED:
            self._steps.finished(about["job_id"])
        return []

    def _trouble(self, text: str) -> list[str]:
        """An error or a warning, unless it repeats what was said of a step."""
        if text.startswith(_END):
            return self._steps.stopped()
        return [] if any(again in text for again in _AGAIN) else [text]

    def close(self) -> None:
        """Close the file of events."""
        if self._events is not None:
            self._events.close()
        super().close()

    @property
    def writes_to_stream(self) -> bool:
        """Whether lines stand in for Snakemake's own output."""
        said = self.common_settings
        own = said.verbose or said.dryrun or said.printshellcmds or said.debug_dag
        return self._events is None and not own

    @property
    def writes_to_file(self) -> bool:
        """Not a log that Snakemake would mention at its end."""
        return False

    @property
    def has_filter(self) -> bool:
        """Events are chosen here; for lines, Snakemake's own filter follows ``--quiet``."""
        return self._events is not None

    @property
    def has_formatter(self) -> bool:
        """Errors are worded by Snakemake."""
        return False

    @property
    def needs_rulegraph(self) -> bool:
        """No."""
        return False
