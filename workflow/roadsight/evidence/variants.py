"""The workflow's own rules once more on a finished site, with some settings changed.

A variant shares every artifact that the change does not touch: it starts from the finished results
in a work folder of its own, and Snakemake's own rules of staleness recompute the rest.
"""

from __future__ import annotations

import contextlib
import csv
import logging
import os
import re
import shutil
import subprocess
import sys
from base64 import urlsafe_b64decode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roadsight.base.errors import InputError
from roadsight.config.load import merged
from roadsight.io.records.atomic import write_json
from roadsight.io.records.run_records import last_usage
from roadsight.io.records.sources import package_digest

log = logging.getLogger(__name__)
# A variant runs in a folder of its own and has to find this package.
_PACKAGE = Path(__file__).resolve().parents[2]
_CONFIG = "variant.json"  # The variant's configuration in its folder.
# Log of a job that failed, as Snakemake's output names it.
_LOG = re.compile(r"^ +log: (\S+)", re.MULTILINE)
_MESSAGE = "roadsight: "  # Begins the line by which a stage tells its own message.
# Begin of a job in Snakemake's output.
_JOB = re.compile(r"^(?:local)?(?:rule|checkpoint) (\w+):$", re.MULTILINE)


class VariantError(InputError):
    """The workflow failed in a variant's folder."""


@dataclass(frozen=True)
class JobRecord:
    """What one job of the workflow used.

    Parameters
    ----------
    rule, log : its rule, and its log in the variant's folder. ran : whether the variant ran it; if
    not, it is the base's own record. cpu_s, peak_mib : processor time of user and system, s, and
    most resident memory, MiB, as the stage measured them. wall_s : time on the clock, s, from its
    benchmark file.
    """

    rule: str
    log: str
    ran: bool
    cpu_s: float
    wall_s: float
    peak_mib: float


@dataclass(frozen=True)
class Variant:
    """A site that is run again with some settings changed.

    Parameters
    ----------
    folder : its work folder, deleted by whoever made it. site : name of the site.
    """

    folder: Path
    site: str

    @classmethod
    def prepare(
        cls,
        base: str | os.PathLike[str],
        folder: str | os.PathLike[str],
        config: Mapping[str, Any],
        site: str,
        changes: Mapping[str, Any],
        plans: Sequence[str] = (),
    ) -> Variant:
        """Set up the work folder; nothing is run yet.

        Parameters
        ----------
        base : folder where the workflow has finished the site.
        folder : the work folder, replaced if it is there; within ``base``'s file system, so that
            results can be linked.
        config : the whole configuration of the base's run.
        site : name of the site, as in ``results/<site>``.
        changes : settings by section that differ, such as ``{"lidar": {"surfel_size_m": 0.2}}``.
        plans : plans to solve, if not those of the base.

        Raises
        ------
        InputError : the site has no results in ``base``.
        """
        mirror_site(Path(base).resolve(), Path(folder), site)
        content = dict(config)
        content["overrides"] = merged(config.get("overrides", {}), changes)
        if plans:
            content["plans"] = list(plans)
        write_json(Path(folder) / _CONFIG, content)
        return cls(Path(folder), site)

    def result(self, name: str) -> Path:
        """Path of one of the site's results."""
        return self.folder / "results" / self.site / name

    def run(
        self, targets: Sequence[str], cores: int = 1, again: Sequence[str] = ()
    ) -> dict[str, int]:
        """Bring results up to date.

        Parameters
        ----------
        targets : names below ``results/<site>``. cores : given to Snakemake.
        again : rules to run again even if nothing changed; after a single one nothing else runs,
            after several all that builds on them.

        Returns
        -------
        Number of jobs that ran, by rule.

        Raises
        ------
        VariantError : the workflow failed; what it said at the end.
        """
        forced = ["--forcerun", *again] if again else []
        # Of several rules, --until stops at the first that others of them build on.
        forced += ["--until", *again] if len(again) == 1 else []
        output = self._snakemake(targets, "--cores", str(cores), *forced)
        rules = _JOB.findall(output)
        return {rule: rules.count(rule) for rule in sorted(set(rules))}

    def repeat(
        self, targets: Sequence[str], jobs: Sequence[JobRecord], times: int, cores: int = 1
    ) -> list[list[JobRecord]]:
        """Run all jobs of some rules behind ``targets`` again and again.

        What they write must come out as before, or later runs find what follows stale.

        Parameters
        ----------
        jobs : their records, see `records`.

        Returns
        -------
        The same jobs' new records, each time.
        """
        rules = sorted({job.rule for job in jobs})
        found = []
        for _ in range(times):
            self.run(targets, cores, again=rules)
            found.append([self._record(job.rule, job.log) for job in jobs])
        return found

    def records(self, targets: Sequence[str]) -> list[JobRecord]:
        """What each job behind ``targets`` used, whether the variant or its base ran it.

        Raises
        ------
        VariantError : a job's log does not say what it used.
        """
        listed = self._snakemake(targets, "--summary")
        rows = csv.DictReader(listed[listed.index("output_file\t") :].splitlines(), delimiter="\t")
        jobs = {row["log-file(s)"]: row["rule"] for row in rows if row["log-file(s)"] != "-"}
        return [self._record(rule, path) for path, rule in sorted(jobs.items())]

    def _record(self, rule: str, path: str) -> JobRecord:
        usage = last_usage(self.folder / path)
        inside = Path(path).relative_to(Path("logs") / self.site)
        benchmark = self.result("benchmarks") / inside.with_suffix(".tsv")
        if usage is None or not benchmark.is_file():
            raise VariantError(f"{path} in {self.folder} does not say what the job used")
        lines = list(csv.DictReader(benchmark.read_text().splitlines(), delimiter="\t"))
        ran = benchmark.stat().st_mtime_ns > (self.folder / _CONFIG).stat().st_mtime_ns
        return JobRecord(rule, path, ran, usage.cpu_s, float(lines[-1]["s"]), usage.peak_mib)

    def _snakemake(self, targets: Sequence[str], *options: str) -> str:
        """Standard output and error of Snakemake in the variant's folder."""
        names = [f"results/{self.site}/{target}" for target in targets]
        # With shell commands, Snakemake names its jobs itself.
        said = ("--configfile", _CONFIG, "--printshellcmds")
        command = [sys.executable, "-m", "snakemake", *names, *said, *options]
        # This package first, and no profile of the caller's.
        given = {key: value for key, value in os.environ.items() if key != "SNAKEMAKE_PROFILE"}
        path = os.pathsep.join(filter(None, (str(_PACKAGE), given.get("PYTHONPATH", ""))))
        finished = subprocess.run(
            command,
            cwd=self.folder,
            env=given | {"PYTHONPATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        if finished.returncode != 0:
            log.error("%s failed:\n%s", " ".join(command), finished.stdout[-4000:])
            raise VariantError(
                "the workflow failed",
                where=str(self.folder),
                found=self._told(finished.stdout),
                hint="see the logs in that folder",
            )
        return finished.stdout

    def _told(self, output: str) -> str:
        """What a stage or the configuration said was wrong, else the last that Snakemake said."""
        logs = [self.folder / name for name in dict.fromkeys(_LOG.findall(output))]
        texts = [path.read_text(errors="replace") for path in logs if path.is_file()]
        lines = [line for text in (output, *texts) for line in text.splitlines()]
        told = [line for line in lines if line.startswith(_MESSAGE)]
        return told[-1].removeprefix(_MESSAGE) if told else output.strip()[-400:]


# A work folder that shares a finished site's files with another one, which it cannot change.

# What a mirror has of its own; everything else of the project is linked.
_OWN = {"results", "logs", ".snakemake", ".git"}
# What Snakemake knows of outputs: without it, all of them would be stale.
_METADATA = Path(".snakemake/metadata")


def mirror_site(base: Path, folder: Path, site: str) -> None:
    """Fill ``folder`` with what a run needs to go on from the finished ``site`` of ``base``.

    Results are hard links, or copies on another file system: Snakemake deletes an output before it
    makes it anew and stages rename theirs into place, so nothing is written through a link. What
    is written in place (logs, benchmark files, Snakemake's records) is copied. Everything else of
    the project is linked. A folder that is already there is replaced.

    Raises
    ------
    InputError : the site has no results in ``base``.
    """
    if not (base / "results" / site).is_dir():
        raise InputError(
            f"site {site!r} has no results to start from",
            where=str(base / "results"),
            hint=f"run the workflow on {site} first",
        )
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for entry in sorted(base.iterdir()):
        if entry.name not in _OWN:
            (folder / entry.name).symlink_to(entry.resolve())
    logs, results = Path("logs") / site, Path("results") / site
    if (base / logs).is_dir():
        shutil.copytree(base / logs, folder / logs)

    def place(source: str, target: str) -> None:
        if not Path(source).is_relative_to(base / results / "benchmarks"):
            with contextlib.suppress(OSError):
                os.link(source, target)
                return
        shutil.copy2(source, target)

    unfinished = shutil.ignore_patterns(".*.tmp*")
    shutil.copytree(base / results, folder / results, copy_function=place, ignore=unfinished)
    # Snakemake takes a folder of records without this one for one of an old version.
    (folder / _METADATA.parent / "incomplete").mkdir(parents=True)
    for record in sorted(path for path in (base / _METADATA).rglob("*") if path.is_file()):
        name = record.relative_to(base / _METADATA)
        encoded = "".join(part.removeprefix("@") for part in name.parts)
        if urlsafe_b64decode(encoded).decode().startswith(f"{results}/"):
            (folder / _METADATA / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(record, folder / _METADATA / name)
    # Compiled kernels, which both may add to, and the checksums of input files.
    caches, shared = (root / ".snakemake/roadsight" for root in (base, folder))
    shared.mkdir(parents=True)
    kernels = caches / f"numba-{package_digest()}"
    kernels.mkdir(parents=True, exist_ok=True)
    (shared / kernels.name).symlink_to(kernels.resolve())
    if (caches / "checksums.json").is_file():
        shutil.copy2(caches / "checksums.json", shared)
