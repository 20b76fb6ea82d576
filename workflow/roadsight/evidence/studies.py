"""Schema of ``config/tradeoffs.yaml``: what is varied, what is measured, what others published."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from roadsight.base.engines import is_usable
from roadsight.base.errors import InputError
from roadsight.base.section import Count, Name, Section, validated
from roadsight.base.texts import read_yaml
from roadsight.config.load import ResolvedSite, load_config, load_site, load_sites, merged
from roadsight.config.schema import Config, Settings
from roadsight.evidence.metrics import METRICS
from roadsight.io.records.sources import stage_module

NAMED = "configuration"  # Knob of a study whose levels are whole configuration files.
PLAN = "plan"  # Knob of a study whose levels are plans; empty: the site's own.
WHOLE_JOB = "all"  # Stage of a measure whose cost is that of all steps of the job.
_Value = int | float | str
_Levels = Annotated[dict[str, _Value | list[float]], Field(min_length=2)]
Job = Literal["placement", "poles"]


class Measure(Section):
    """One accuracy beside one cost."""

    stage: str = Field(description="rule whose cost counts, or all: every step of the job")
    metric: str = Field(description="accuracy, see roadsight.evidence.metrics")


class Published(Section):
    """What a publication says of the same trade-off."""

    source: str = Field(description="where it is printed")
    columns: list[str] = Field(min_length=1, description="names, with units")
    rows: list[list[_Value]] = Field(min_length=1, description="as printed")

    @model_validator(mode="after")
    def _rectangular(self) -> Published:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"every row needs {len(self.columns)} entries")
        return self


class Study(Section):
    """One knob at several levels."""

    job: Job = Field(description="job that is run: placement or poles")
    site: str = Field(default="", description="site, if not that of the job")
    title: str = Field(description="what is varied, for people")
    knob: str = Field(description=f"setting that is varied, {NAMED} or {PLAN}")
    unit: str = Field(default="", description="unit of the levels, for people")
    levels: _Levels = Field(description="name of each level and its value, coarse to fine")
    settings: dict[str, Any] = Field(
        default={}, description="settings of every level, by section, to keep the study small"
    )
    reference: str | None = Field(
        default=None, description="level that others are compared with where no truth is known"
    )
    repeats: Count = Field(default=2, description="timings of each stage; the least one counts")
    measures: list[Measure] = Field(min_length=1, description="accuracies and costs")
    why: str = Field(description="why the default is what it is")
    published: Published | None = Field(default=None, description="published figures")

    @model_validator(mode="after")
    def _named(self) -> Study:
        if self.knob == PLAN and self.job != "placement":
            raise ValueError(f"plans are of the job placement, not of {self.job}")
        if self.reference is not None and self.reference not in self.levels:
            raise ValueError(f"reference {self.reference!r} is no level")
        for measure in self.measures:
            if measure.stage != WHOLE_JOB:
                try:
                    stage_module(measure.stage)
                except ValueError:
                    told = f"unknown stage {measure.stage!r}: a rule's name, or {WHOLE_JOB}"
                    raise ValueError(told) from None
            if measure.metric not in METRICS:
                raise ValueError(f"unknown metric {measure.metric!r}: {', '.join(METRICS)}")
            metric = METRICS[measure.metric]
            if metric.job != self.job:
                raise ValueError(f"metric {measure.metric!r} is one of the job {metric.job}")
            if metric.needs_reference and self.reference is None:
                raise ValueError(f"metric {measure.metric!r} needs a reference level")
        return self

    @property
    def default(self) -> str:
        """Name of the level that is the default setting.

        Raises
        ------
        ValueError : there is none.
        """
        usual: Any = ""
        if self.knob not in (NAMED, PLAN):
            usual = Settings().model_dump()
            for part in self.knob.split("."):
                if not isinstance(usual, Mapping) or part not in usual:
                    raise ValueError(f"no setting {self.knob!r}")
                usual = usual[part]
        for name, value in self.levels.items():
            if value == usual:
                return name
        raise ValueError(f"no level has the default {usual!r} of {self.knob}")

    def changes(self, level: str) -> dict[str, Any]:
        """Settings by section that make a level.

        Raises
        ------
        InputError : the level's configuration file is wrong.
        """
        value = self.levels[level]
        if self.knob == PLAN:
            return self.settings
        if self.knob != NAMED:
            change: Any = value
            for part in reversed(self.knob.split(".")):
                change = {part: change}
            return merged(self.settings, change)
        return merged(self.settings, load_overrides(str(value)) if value else {})

    def plan(self, level: str) -> str:
        """Plan that a level solves, or nothing: the first that the site asks for."""
        return str(self.levels[level]) if self.knob == PLAN else ""

    @property
    def metrics(self) -> list[str]:
        """All metrics, without repeats."""
        return list(dict.fromkeys(measure.metric for measure in self.measures))

    @property
    def stages(self) -> list[str]:
        """Rules that are timed again and again, without repeats."""
        named = dict.fromkeys(measure.stage for measure in self.measures)
        return [stage for stage in named if stage != WHOLE_JOB]


class PublishedStage(Section):
    """A stage of the published pipeline and what it took (paper 2, Table 4)."""

    title: str = Field(description="name as printed")
    minutes_per_mile: float = Field(gt=0, description="run time, min/mile")
    cores: Count = Field(description="processor cores that it was given")
    gpu: bool = Field(default=False, description="whether it used a GPU as well")
    rules: list[str] = Field(min_length=1, description="rules that do the same here")


class Tradeoffs(Section):
    """The whole file."""

    sites: dict[Job, str] = Field(description="site on which each job is measured")
    published_stages: list[PublishedStage] = Field(description="published costs by stage")
    studies: dict[Name, Study] = Field(min_length=1, description="studies by name")

    def site_of(self, study: Study) -> str:
        """Site file on which a study is measured."""
        return study.site or self.sites[study.job]


def load_tradeoffs(path: str | os.PathLike[str], has_open3d: bool | None = None) -> Tradeoffs:
    """Read and check the file; studies of Open3D are left out where it cannot be loaded.

    Parameters
    ----------
    has_open3d : whether the steps will have it, whatever this interpreter has; None: as it has.

    Raises
    ------
    InputError : malformed, an unknown key, metric or setting, or a study without its default.
    """
    where = str(path)
    content = read_yaml(path)
    studies = content.get("studies") if isinstance(content, dict) else None
    for given in studies.values() if isinstance(studies, dict) else ():
        # Levels given as a list are named by their values.
        if isinstance(given, dict) and isinstance(given.get("levels"), list):
            values = given["levels"]
            given["levels"] = {f"{v:g}" if isinstance(v, float) else str(v): v for v in values}
    found = validated(Tradeoffs, content, where)
    for name, study in found.studies.items():
        if study.job not in found.sites:
            raise InputError(f"no site for the job {study.job}", where=f"{where}: sites")
        try:
            study.default  # noqa: B018
        except ValueError as error:
            raise InputError(str(error), where=f"{where}: studies.{name}") from error
        for level in study.levels:
            at = f"{where}: studies.{name}.levels.{level}"
            validated(Settings, merged(Settings().model_dump(), study.changes(level)), at)
    if is_usable() if has_open3d is None else has_open3d:
        return found
    kept = {n: s for n, s in found.studies.items() if "open3d" not in s.levels.values()}
    return found.model_copy(update={"studies": kept})


def load_evidence_sites(config: Config, tradeoffs: Tradeoffs) -> dict[str, ResolvedSite]:
    """Sites on which the studies are measured, by their names, whatever plans a run asks for.

    Raises
    ------
    InputError : as `roadsight.config.load.load_sites`, or a study names an unknown plan.
    """
    files = dict.fromkeys(tradeoffs.sites.values())
    for study in tradeoffs.studies.values():
        file = tradeoffs.site_of(study)
        files[file] = None
        plans = [plan for plan in map(study.plan, study.levels) if plan]
        if plans:
            load_site(file, config.model_copy(update={"plans": plans}))
    return load_sites(config.model_copy(update={"sites": list(files), "plans": []}))


def load_overrides(path: str) -> dict[str, Any]:
    """Settings that a configuration file such as ``config/quick.yaml`` overrides."""
    config = load_config(merged(Config().model_dump(), read_yaml(path) or {}), path)
    validated(Settings, merged(Settings().model_dump(), config.overrides), f"{path}: overrides")
    return config.overrides
