"""A commented starter site file from what is found in clouds."""

from __future__ import annotations

import json
import os
import re
import textwrap
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roadsight.base.errors import InputError
from roadsight.config.schema import Settings
from roadsight.geometry.crs import unit_name
from roadsight.geometry.location import utm_code
from roadsight.geometry.reference import UnitChoice, resolve
from roadsight.geometry.site import centre_of, site_frame
from roadsight.io.cloud.cloud_scan import CloudScan, Contents, check_copies, kept_chunks, scan_cloud
from roadsight.placement.candidates.targets import points_needed
from roadsight.scene.classes import CLASS_NAMES
from roadsight.scene.profile import CELL_M, density, merge_counts

_DATA_VARIABLE = "ROADSIGHT_DATA"  # environment variable that names the folder of a user's clouds
_LETTERS = {
    "äöüßøæœþłđðı": "ae oe ue ss oe ae oe th l d d i",
    "абвгдеёжзийклмнопрстуфхцчшщъыьэюяіїєґ": (
        "a b v g d e e zh z i i k l m n o p r s t u f kh ts ch sh shch _ y _ e yu ya i i ie g"
    ),
    "αβγδεζηθικλμνξοπρσςτυφχψω": "a v g d e z i th i k l m n x o p r s s t y f ch ps o",
}
# Letters that names of folders do without, as passports write them.
_WRITTEN_OUT = str.maketrans(
    {
        letter: plain.strip("_")
        for letters, written in _LETTERS.items()
        for letter, plain in zip(letters, written.split(), strict=True)
    }
)


# Plans of a first run: two sensors that most roads can be covered with.
FIRST_PLANS = ("os-64", "os-128")
# Metres between its candidates, along edges and in height: on an airborne arterial of 1 million
# points 1,490 candidates instead of 11,488.
_FIRST_SPACING_M = (8.0, 2.0)
# Limit of its covers; what is not proven by then has a bound. The arterial's plans have 26 and 51
# sensors (at least 24 and 47), as with 20 s.
_FIRST_LIMIT_S = 5.0


@dataclass(frozen=True)
class Finding:
    """A key of the site file as found.

    Parameters
    ----------
    value : YAML value.
    comment : what it rests on.
    required : whether the user has to set it before the site can run.
    """

    value: str
    comment: str
    required: bool = False

    def lines(self, key: str) -> str:
        """Comment and key in the site file."""
        comment = f"Required: {self.comment}" if self.required else self.comment
        return f"{_comment(comment)}\n{key}: {self.value}"


@dataclass(frozen=True)
class Starter:
    """What is to be said about clouds, and the site file that says it.

    Parameters
    ----------
    name : of the site. text : of the file. found : sentences on the clouds. assumed : on keys that
    were decided, by key. doubts : what the default settings cannot do. missing : what the user has
    to fill in, by key.
    """

    name: str
    text: str
    found: list[str]
    assumed: dict[str, str]
    doubts: list[str]
    missing: dict[str, str]


def start_site(
    clouds: Sequence[Path],
    path: Path,
    name: str,
    title: str,
    given: Mapping[str, str] | None = None,
) -> Starter:
    """Site file of clouds that is to lie at ``path``; nothing is written.

    Parameters
    ----------
    name : of the site. title : its name for people. given : values of keys that the user knows.

    Raises
    ------
    InputError : a cloud cannot be read, or they contradict each other.
    """
    check_copies(clouds)
    contents = Contents()
    scans = [scan_cloud(cloud, take=contents.take) for cloud in clouds]
    findings, unit_m = _find_keys(scans)
    findings |= {
        key: Finding(json.dumps(value), "as given")
        for key, value in (given or {}).items()
        if key in findings
    }
    density_m2 = None if unit_m is None else _density(scans, unit_m)
    found = _describe_clouds(scans, contents, unit_m, density_m2)
    notes = [
        f"{scan.header.path.name}: {note}"
        for scan in scans
        for note in (*scan.header.notes, *scan.header.stated.notes)
    ]
    text = site_text(name, [_written(cloud, path) for cloud in clouds], found, findings, title)
    told = {
        required: {key: f.comment for key, f in findings.items() if f.required == required}
        for required in (False, True)
    }
    return Starter(name, text, [*found, *notes], told[False], doubts(density_m2), told[True])


def doubts(density_m2: float | None) -> list[str]:
    """What the default settings cannot do with the cloud.

    Parameters
    ----------
    density_m2 : median of points per m2 where there are any; None if not known in metres.
    """
    targets = Settings().targets
    needed = targets.min_points
    if needed == "local":
        needed = points_needed(2 * targets.radius_m, targets.cell_size_m)
    if density_m2 is None or density_m2 >= needed:
        return []
    return [
        f"{density_m2:.2g} points per m2 are sparse: a target is placed where a square metre has"
        f" {needed} (targets.min_points), so most of the pavement would not be examined"
    ]


def site_name(text: str, where: str = "--site") -> str:
    """Name of letters, digits, - and _ that the workflow accepts, from any text.

    Umlauts, Cyrillic and Greek letters are written out (``Mühle`` gives ``muehle``); other accents
    are left off.

    Raises
    ------
    InputError : nothing is left; ``where`` the text stands is said.
    """
    plain = unicodedata.normalize("NFC", text.lower()).translate(_WRITTEN_OUT)
    bare = "".join(c for c in unicodedata.normalize("NFKD", plain) if not unicodedata.combining(c))
    name = re.sub(r"[^a-z0-9_-]+", "_", bare.translate(_WRITTEN_OUT)).strip("_-")
    if not name:
        raise InputError(
            "gives no name of a site",
            where=where,
            found=repr(text),
            allowed="letters a to z, digits, - and _",
            hint="state one: --site NAME",
        )
    return name


def _find_keys(scans: Sequence[CloudScan]) -> tuple[dict[str, Finding], float | None]:
    """CRS and unit keys of the site file: found, assumed, or required of the user.

    Also metres in one unit of x and y, or None while that is open.
    """
    auto = Finding(
        "auto",
        "auto takes the unit of the CRS, and metres where crs is local; or metre, foot,"
        " us-survey-foot",
    )
    missing = next((scan.header for scan in scans if scan.header.stated.crs is None), None)
    if missing is not None:
        problem = f" ({missing.stated.problem})" if missing.stated.problem else ""
        reason = f"{missing.path.name} names no CRS{problem}"
        comment = f"EPSG code, WKT, or local for a cloud without one: {reason}"
        crs = Finding("null", comment, True)
        return {"crs": crs, "units": auto, "vertical_units": auto}, None
    stated = [(str(scan.header.path), scan.header.stated) for scan in scans]
    lower, upper = _corners(scans)
    centre = centre_of(lower, upper)
    reference = resolve(stated, centre, UnitChoice(vertical_units="metre"))
    if reference.crs is not None and reference.crs.is_geographic:
        crs = Finding("auto", f"auto takes {reference.name} from the header, in degrees")
        target = Finding(utm_code(*centre), "projected CRS to read the cloud in; the UTM zone here")
        return {"crs": crs, "target_crs": target, "units": auto, "vertical_units": auto}, None
    try:
        site_frame(reference, lower, upper, str(scans[0].header.path))
        crs = Finding("auto", f"auto takes {reference.name} from the header")
    except InputError as error:
        crs = Finding("null", f"the header's own cannot be right: {error}", True)
    units = Finding("auto", f"auto takes that of the CRS, here {unit_name(reference.unit_m)}")
    try:
        read = resolve(stated, centre, UnitChoice())
        here = "; ".join([f"here {unit_name(read.vertical_unit_m)}", *read.notes])
        vertical = Finding("auto", here)
    except InputError as error:
        vertical = Finding("auto", str(error), True)
    unit_m = None if crs.required else reference.unit_m
    return {"crs": crs, "units": units, "vertical_units": vertical}, unit_m


def site_text(
    name: str,
    clouds: Sequence[str],
    contents: Sequence[str],
    findings: dict[str, Finding],
    title: str = "",
) -> str:
    """Content of the site file."""
    found = "\n".join(_comment(sentence) for sentence in contents)
    paths = "\n".join(f"  - {json.dumps(cloud, ensure_ascii=False)}" for cloud in clouds)
    keys = "\n".join(finding.lines(key) for key, finding in findings.items())
    (along, up), usual = _FIRST_SPACING_M, Settings()
    spacing = (
        f"{usual.candidates.spacing_m:g} m along edges, {usual.candidates.height_step_m:g} m up"
    )
    return f"""# Site file, written by `roadsight init`. Found in the clouds:
{found}

# Name of the site: its results go to results/{name}.
site: {json.dumps(name)}
# Name for people.
title: {json.dumps(title or name, ensure_ascii=False)}
# LAS or LAZ files: relative to this file, absolute, or with ${{VARIABLE}} from the environment.
clouds:
{paths}
{keys}
# What to compute: placement, or scene for ground, pavement and edges alone.
jobs: [placement]
placement:
  # Plans of config/plans.yaml to solve: two for a first answer; null solves all everyday ones.
  plans: [{", ".join(FIRST_PLANS)}]
  # Digitised road edges (GeoJSON, GeoPackage, Shapefile, CSV); null finds them on the pavement.
  edges: null
  # Polygon of the area to be monitored; null takes the pavement that is found.
  tma: null
  # Polygons in which no sensor may stand; existing poles that may carry one (points, height_m).
  # zones: zones.geojson
  # mounts: poles.geojson
# Picture below the report's map (GeoTIFF with a CRS, 8 bits), beside the relief.
# orthophoto: orthophoto.tif
# Settings of config/config.yaml that are others here.
settings:
  # Parts of the candidates, and of a videolog's images, that are computed beside each other: with
  # one, each of two cores has a sensor. Usual are {usual.shards}: take more for more cores, usual
  # candidates or images; each part loads the scene anew.
  shards: 1
  # Few candidates, for a quick first answer; usual are {spacing}.
  candidates: {{spacing_m: {along:g}, height_step_m: {up:g}}}
  # Usual are {usual.cover.time_limit_s:g} s. A plan that is not proven by then has a bound.
  cover: {{time_limit_s: {_FIRST_LIMIT_S:g}}}
  coverage:
    # The same for candidates added where too little is seen; usual are {usual.coverage.shards}.
    shards: 1
    # Objects in the way (trees, signs) to solve each plan without; 1 tells what the worst costs.
    felled: 0
    # Targets that no candidate sees are left out and reported with what hides them; `error` stops
    # instead, as for a plan that must see all.
    uncoverable: exclude
  # Vehicles that passed during a mobile scan stand as walls on the road; this clears them.
  # lidar: {{clear_below_m: 4.5}}
"""


def _describe_clouds(
    scans: Sequence[CloudScan], contents: Contents, unit_m: float | None, density_m2: float | None
) -> list[str]:
    """Extent, density, classes and other contents, one sentence each."""
    lower, upper = _corners(scans)
    length = unit_m or 1.0
    unit = "m" if unit_m else "units of the cloud"
    square = "m2" if unit_m else "square unit"
    dense = _density(scans, length) if density_m2 is None else density_m2
    size = " x ".join(f"{side:.1f}" for side in (upper - lower)[:2] * length)
    total = contents.classes.total()
    named = ", ".join(
        f"{c} {CLASS_NAMES.get(c, 'not a common class')} {n / total:.1%}"
        for c, n in sorted(contents.classes.items())
    )
    dropped = sum(scan.withheld + scan.noise + scan.synthetic for scan in scans)
    return [
        f"{total} points, {dropped} withheld, noise or synthetic left out.",
        f"Extent {size} {unit}; as stored x {lower[0]:.2f} to {upper[0]:.2f}, "
        f"y {lower[1]:.2f} to {upper[1]:.2f}, z {lower[2]:.2f} to {upper[2]:.2f}.",
        f"Density {dense:.2f} points per {square} where there are any (median).",
        f"Classes: {named}.",
        f"Intensity: {'yes' if contents.intense else 'no'}. "
        f"Colour: {'yes' if all(scan.brightest for scan in scans) else 'no'}.",
    ]


def _density(scans: Sequence[CloudScan], unit_m: float) -> float:
    """Median density of occupied ground, in points per m2."""
    places, count = np.empty((2, 0), np.int64), np.empty(0, np.int64)
    for scan in scans:
        for chunk, *_ in kept_chunks(scan.header.path):
            cells = np.floor(chunk.xyz[:, 1::-1].T * unit_m / CELL_M).astype(np.int64)
            cells, chunk_count = merge_counts(cells, np.ones(len(chunk), np.int64))
            places, count = merge_counts(np.hstack([places, cells]), np.append(count, chunk_count))
    return density(places[1], places[0], count)["median"]


def _corners(scans: Sequence[CloudScan]) -> tuple[np.ndarray, np.ndarray]:
    lower = np.min([scan.lower for scan in scans], axis=0)
    return lower, np.max([scan.upper for scan in scans], axis=0)


def _written(cloud: Path, site_file: Path) -> str:
    """Path of a cloud for the site file, so that both can move together."""
    absolute = cloud.resolve()
    data = os.environ.get(_DATA_VARIABLE)
    if data and absolute.is_relative_to(Path(data).resolve()):
        return f"${{{_DATA_VARIABLE}}}/{absolute.relative_to(Path(data).resolve()).as_posix()}"
    if absolute.is_relative_to(Path.cwd()) and site_file.resolve().is_relative_to(Path.cwd()):
        return Path(os.path.relpath(absolute, site_file.resolve().parent)).as_posix()
    return absolute.as_posix()


def _comment(text: str) -> str:
    """Text as comment lines."""
    lines = textwrap.wrap(text, 96, break_long_words=False, break_on_hyphens=False)
    return "\n".join(f"# {line}" for line in lines)
