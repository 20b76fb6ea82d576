"""Settings of a run as a whole."""

from __future__ import annotations

from pydantic import Field

from roadsight.base.section import Count, Section
from roadsight.base.seeds import SEED


class Run(Section):
    """What all steps share."""

    seed: int = Field(default=SEED, ge=0, description="seed of everything random")
    shards: Count = Field(default=4, description="shards of depth maps, detections and images")
