"""Schema of a site file: where its cloud is, in which CRS and units, and which jobs it asks for."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from roadsight.config.schema import Count, Metres, Name, Section

Unit = Literal["auto", "metre", "foot", "us-survey-foot"]


class Sample(Section):
    """A site that the workflow generates itself, with known truth."""

    scene: Literal["highway"] = Field(default="highway", description="analytic scene")
    points: Count = Field(default=3_500_000, description="points to scan")
    length_m: Metres = Field(default=250.0, description="length of road, m")


class PlacementInputs(Section):
    """What a user may give the placement job instead of having it found."""

    edges: str | None = Field(
        default=None, description="digitised edges: GeoJSON, GeoPackage or CSV; automatic if absent"
    )
    edges_crs: str | None = Field(
        default=None, description="CRS of the edges if their file names none"
    )
    tma: str | None = Field(
        default=None, description="polygon of the monitored area; found if absent"
    )
    plans: list[str] | None = Field(
        default=None, description="plans to solve; all of them if absent"
    )


class Truth(Section):
    """Reference data for scoring only."""

    pavement: str | None = Field(default=None, description="surveyed road polygons")
    pavement_crs: str | None = Field(default=None, description="their CRS if the file names none")
    reach_m: float = Field(
        default=float("inf"), gt=0, description="what lies further from the truth is unknown, m"
    )


class Site(Section):
    """One site."""

    site: Name = Field(description="name; results go to results/<site>")
    title: str = Field(default="", description="name for people")
    clouds: list[str] = Field(default=[], description="LAS or LAZ files; ${VARIABLE} is replaced")
    sample: Sample | None = Field(default=None, description="generate the cloud instead")
    crs: str | None = Field(
        default=None, description="auto (the file's own), local, EPSG:nnnn or WKT"
    )
    units: Unit = Field(default="auto", description="horizontal unit of the coordinates")
    vertical_units: Unit = Field(default="auto", description="vertical unit of the coordinates")
    target_crs: str | None = Field(default=None, description="reproject to this CRS on reading")
    jobs: list[Literal["scene", "placement"]] = Field(
        default=["placement"],
        min_length=1,
        description="scene: ground, pavement, edges; placement: all",
    )
    placement: PlacementInputs = PlacementInputs()
    truth: Truth = Truth()
    settings: dict[str, Any] = Field(
        default={}, description="settings of config.yaml that differ at this site"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Site:
        if bool(self.clouds) == bool(self.sample):
            raise ValueError("give either clouds (a list of files) or sample, not both or neither")
        return self
