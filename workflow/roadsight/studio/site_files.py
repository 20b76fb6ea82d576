"""Files beside a site's settings, and the names of them in the site file."""

from __future__ import annotations

import csv
import hashlib
import json
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field

from roadsight.base.errors import InputError
from roadsight.config.load import SITES, resolve_site
from roadsight.config.plans import FILES
from roadsight.config.starter import site_name, start_site
from roadsight.io.records.atomic import atomic_path
from roadsight.studio.project import FRAME, Project, SiteFolder
from roadsight.studio.requests import Body

Writer = Callable[[Path], Any]
Part = Literal["drawing", "decisions", "registration", "plans"]
_SAMPLE_EDGES = "sample/edges.geojson"

# Of each part that people save: section, its keys with the files that the studio writes for them,
# and the results that it rests on
_FILES: dict[Part, tuple[str, dict[str, str], tuple[str, ...]]] = {
    "drawing": (
        "placement",
        {name: f"{name}.geojson" for name in ("edges", "zones", "mounts", "tma")},
        (FRAME, _SAMPLE_EDGES),
    ),
    "decisions": ("poles", {"decisions": "pole_decisions.csv"}, (FRAME,)),
    "registration": (
        "poles",
        {"baseline": "baseline.json", "corrections": "corrections.csv"},
        (FRAME, "poles/frames.parquet"),
    ),
    "plans": ("placement", {}, ()),
}

_NAMES = {key: name for _, names, _ in _FILES.values() for key, name in names.items()}
_saving = threading.RLock()


class OutdatedError(InputError):
    """What was to be saved rests on files that have changed since."""


def site_version(site: SiteFolder, part: Part) -> str:
    """A short text that changes with what a part of a site was read from."""
    section, keys, results = _FILES[part]
    named = [site.resolved.beside(_named(site, section, key)) for key in keys]
    plans = site.resolved.site.placement.own_plans if part == "plans" else {}
    files = (plan.file_of(option) for plan in plans.values() for option in FILES)
    named += [site.resolved.beside(file) for file in files]
    paths = [*(site.results / name for name in results), *(Path(n) if n else None for n in named)]
    contents = [
        [str(path), hashlib.sha256(path.read_bytes()).hexdigest()]
        if path and path.is_file()
        else [str(path), ""]
        for path in paths
    ]
    contents += [[name, plan.model_dump_json()] for name, plan in plans.items()]
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()[:16]


@contextmanager
def saving(
    project: Project, stem: str, part: Part, version: str | None = None
) -> Iterator[SiteFolder]:
    """A site whose files nobody else changes within the block.

    Parameters
    ----------
    version : `site_version` of what the caller was shown; None: it rests on nothing.

    Raises
    ------
    OutdatedError : it was shown something else.
    """
    with _saving:
        site = project.site(stem)
        if version is not None and version != site_version(site, part):
            raise OutdatedError(
                "its files have changed meanwhile, so nothing was saved",
                where=f"site {stem}",
                hint="open the plan again"
                if part == "plans"
                else "reload the page; what you have not saved stays",
            )
        yield site


def save_beside(
    project: Project,
    site: SiteFolder,
    section: str,
    files: dict[str, Writer],
    named: dict[str, str | None],
    along: dict[str, str] | None = None,
) -> list[str]:
    """Write files into the site's folder and name them in a section of the site file.

    Parameters
    ----------
    files : how to write each, by its name. named : key in the section and the file's name; None
        removes the key, and the file if the studio had written it. along : files that no key names,
        and the key with whose file each goes.

    Returns
    -------
    files that were written, relative to the project

    Raises
    ------
    InputError : a path leads outside the project, the site file cannot be changed so, or a file is
        there that it does not name; nothing is written then.
    """
    with _saving:
        text = project.inside(site.resolved.file).read_bytes().decode()
        for key, name in named.items():
            text = with_value(text, section, key, name and f"{site.stem}/{name}")
        folder = site.resolved.file.parent / site.stem
        own = _own_files(project, site, section)
        for name, key in (along or {}).items():
            if key in own:
                own[name] = own[key].with_name(name)
        changed = write_site(project, site, text, files, {*own.values()})
        plans = site.resolved.plans.values()
        kept = {
            Path(file).resolve() for p in plans for option in FILES if (file := p.file_of(option))
        }
        for key, name in named.items():
            if name is not None or key not in own or own[key] in kept:
                continue
            if own[key] == project.inside(folder / _NAMES.get(key, "")):
                own[key].unlink(missing_ok=True)
        return changed


def write_table(path: Path, rows: Iterable[Iterable[str]]) -> None:
    """Rows of a CSV file, the titles of its columns first."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(rows)


def write_site(
    project: Project, site: SiteFolder, text: str, files: dict[str, Writer], own: set[Path]
) -> list[str]:
    """Write a site file and files in the site's folder, within a block of `saving`.

    Parameters
    ----------
    text : of the site file. files : how to write each, by its name. own : absolute paths that the
        site file names already.

    Returns
    -------
    files that changed, relative to the project

    Raises
    ------
    InputError : as `save_beside`; nothing is written then.
    """
    site_file = project.inside(site.resolved.file)
    resolve_site(yaml.safe_load(text), site.resolved.file, project.config())
    folder = site.resolved.file.parent / site.stem
    paths = {project.inside(folder / name): write for name, write in files.items()}
    contents = {path: _content(path.name, write) for path, write in paths.items()}
    contents[site_file] = text.encode()
    changed = [
        path
        for path, content in contents.items()
        if not (path.is_file() and path.read_bytes() == content)
    ]
    for path in sorted({*changed} - {site_file, *own}):  # what somebody else put there stays
        if path.exists():
            raise InputError(
                "is there already, and the site file does not name it",
                where=str(path),
                hint="move it away, or name it in the site file",
            )
    for path in changed:
        with atomic_path(path) as temporary:
            temporary.write_bytes(contents[path])
    return [str(path.relative_to(project.root)) for path in changed]


def _own_files(project: Project, site: SiteFolder, section: str) -> dict[str, Path]:
    """Files within the project that the site file names, by key."""
    keys = {key for place, found, _ in _FILES.values() if place == section for key in found}
    named = {key: site.resolved.beside(_named(site, section, key)) for key in keys}
    paths = {key: (project.root / path).resolve() for key, path in named.items() if path}
    return {key: path for key, path in paths.items() if path.is_relative_to(project.root)}


def _named(site: SiteFolder, section: str, key: str) -> str | None:
    name: str | None = getattr(getattr(site.resolved.site, section), key)
    return name


def _content(name: str, write: Writer) -> bytes:
    """What a writer writes; under the file's own name, which some formats keep."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


# One value of a site file set or removed, everything else, comments too, left as it is.

Value = str | dict[str, Any] | None
_BREAKS = "\x85\u2028\u2029"  # Ends of lines for YAML, besides those that it escapes by itself


def with_value(text: str, section: str, key: str, value: Value, within: str | None = None) -> str:
    """Text of a YAML file with ``section.key`` set to a text or a mapping, or removed.

    Parameters
    ----------
    text : the file, a mapping at its top. value : None removes the key, and the section with its
        last key. within : section that holds the section.

    Raises
    ------
    InputError : the file is written in a way that this cannot change safely.
    """
    content = yaml.safe_load(text) or {}
    outer = (content.get(within) or {}) if within else content
    if value is None and key not in (outer.get(section) or {}):
        return text
    if within and not outer.get(section):
        return with_value(text, within, section, {key: value})
    if within and value is None and len(outer[section]) == 1:
        return with_value(text, within, section, None)
    inner = dict(outer.get(section) or {})
    inner.pop(key, None)
    if value is not None:
        inner[key] = value
    wanted = {name: part for name, part in outer.items() if name != section}
    if inner or (section in outer and value):
        wanted[section] = inner
    changed = _changed(text, section, key, value, within)
    alike = [wanted, wanted | {section: {}}] if value is None else [wanted]
    if within:
        alike = [content | {within: one} for one in alike]
    try:
        loaded = yaml.safe_load(changed)
    except yaml.YAMLError:
        loaded = None
    if loaded not in alike:
        by_hand = f"set {section}.{key} to {_scalar(value)}" if value else f"remove {key}"
        raise InputError(
            "is written in a way that the studio cannot change",
            where=f"site file: {section}",
            hint=f"{by_hand} by hand",
        )
    return changed


def _changed(text: str, section: str, key: str, value: Value, within: str | None = None) -> str:
    root = yaml.compose(text)
    if within is not None:
        outer = _entry(root, within)
        root = outer[1] if outer else None
    name_text = _scalar(key)
    entry = _entry(root, section)
    if entry is None or not isinstance(root, yaml.MappingNode):
        ended = text if text.endswith("\n") or not text else text + "\n"
        return ended if value is None else f"{ended}{section}:\n  {name_text}: {_scalar(value)}\n"
    name, inner = entry
    if not isinstance(inner, yaml.MappingNode):
        return (
            _replaced(text, inner, f"\n  {name_text}: {_scalar(value)}")
            if value is not None
            else text
        )
    known = _entry(inner, key)
    if value is None:
        return _without(text, bool(root.flow_style), name, inner, known) if known else text
    if known is not None:
        return _replaced(text, known[1], _scalar(value))
    if not inner.value:
        return _replaced(text, inner, f"{{{name_text}: {_scalar(value)}}}")
    first = inner.value[0][0].start_mark
    between = ", " if inner.flow_style else "\n" + " " * first.column
    return f"{text[: first.index]}{name_text}: {_scalar(value)}{between}{text[first.index :]}"


def _entry(node: yaml.Node | None, key: str) -> tuple[yaml.Node, yaml.Node] | None:
    if not isinstance(node, yaml.MappingNode):
        return None
    return next(((name, part) for name, part in node.value if name.value == key), None)


def _replaced(text: str, node: yaml.Node, new: str) -> str:
    """Text with another node; a block scalar ends only where the next line begins."""
    old = text[node.start_mark.index : node.end_mark.index]
    after = old[len(old.rstrip()) :]
    return text[: node.start_mark.index] + new + after + text[node.end_mark.index :]


def _without(
    text: str,
    within_flow: bool,
    name: yaml.Node,
    inner: yaml.MappingNode,
    known: tuple[yaml.Node, yaml.Node],
) -> str:
    """Text without a key, or without its section if it was the last one there."""
    if len(inner.value) == 1 and within_flow:
        return _replaced(text, inner, "{}")
    if len(inner.value) == 1:
        return _cut_lines(text, name, known[1] if not inner.flow_style else inner)
    if not inner.flow_style:
        return _cut_lines(text, *known)
    rest = yaml.MappingNode(
        inner.tag, [pair for pair in inner.value if pair[0] is not known[0]], flow_style=True
    )
    return _replaced(text, inner, yaml.serialize(rest, width=10_000).strip())


def _cut_lines(text: str, first: yaml.Node, last: yaml.Node) -> str:
    """Text without the lines from one node to another."""
    begin = text.rfind("\n", 0, first.start_mark.index) + 1
    # A block ends where the next line begins.
    end = text.find("\n", len(text[: last.end_mark.index].rstrip()))
    return text[:begin] + (text[end + 1 :] if end >= 0 else "")


def _scalar(value: Value) -> str:
    """A text or a mapping as YAML on one line."""
    options: dict[str, Any] = {"width": 10_000, "default_flow_style": True, "sort_keys": False}
    written = str(yaml.safe_dump(value, allow_unicode=True, **options))
    if any(mark in written for mark in _BREAKS):
        written = str(yaml.safe_dump(value, **options))  # escapes them
    return written.removesuffix("\n").removesuffix("\n...").strip()


# A site from a cloud on this machine, as `roadsight init` makes it; looked at first.

_Text = Annotated[str, Field(max_length=4000)]


class CloudBody(Body):
    """A cloud that is to become a site.

    Parameters
    ----------
    path : of the file on this machine. site : name for people; "": that of the file. given : keys
    that the user knows. write : whether to write the site file, or only look.
    """

    path: Annotated[_Text, Field(min_length=1)]
    site: Annotated[str, Field(max_length=100)] = ""
    given: dict[Literal["crs", "target_crs", "units", "vertical_units"], _Text] = Field(default={})
    write: bool = False


def new_site(project: Project, asked: CloudBody) -> dict[str, Any]:
    """What was found in a cloud, and the site file that it makes.

    Raises
    ------
    InputError : no such cloud, it cannot be read, the site is there already, or a given key is
        wrong; nothing is written then.
    """
    cloud = Path(asked.path.strip().strip('"')).expanduser()
    if cloud.suffix.lower() not in (".las", ".laz") or not cloud.is_file():
        raise InputError(
            "is no LAS or LAZ file on this machine", where="cloud", found=str(cloud)[:200]
        )
    title = asked.site.strip() or cloud.stem
    path = SITES / f"{site_name(title)}.yaml"
    if path.exists():
        raise InputError("exists already", where=str(path), hint="choose another name")
    given = {str(key): value for key, value in asked.given.items()}
    starter = start_site([cloud], path, site_name(title), title, given)
    resolve_site(yaml.safe_load(starter.text), path, project.config())
    if asked.write:
        with atomic_path(project.inside(path)) as temporary:
            temporary.write_text(starter.text, encoding="utf-8")
    return {
        "site": starter.name,
        "file": str(path),
        "found": starter.found,
        "assumed": starter.assumed,
        "doubts": starter.doubts,
        "missing": starter.missing,
        "text": starter.text,
        "written": asked.write,
    }
