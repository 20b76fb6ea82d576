"""One value of a site file set or removed, everything else, comments too, left as it is."""

from __future__ import annotations

from typing import Any

import yaml

from roadsight.base.errors import InputError

Value = str | dict[str, Any] | None
_BREAKS = "\x85\u2028\u2029"
"""Ends of lines for YAML, besides those that it escapes by itself."""


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
    wanted = _expected(outer, section, key, value)
    changed = _changed(text, section, key, value, within)
    alike = [wanted, wanted | {section: {}}] if value is None else [wanted]
    if within:
        alike = [content | {within: one} for one in alike]
    if _loaded(changed) not in alike:
        by_hand = f"set {section}.{key} to {_scalar(value)}" if value else f"remove {key}"
        raise InputError(
            "is written in a way that the studio cannot change",
            where=f"site file: {section}",
            hint=f"{by_hand} by hand",
        )
    return changed


def _loaded(text: str) -> Any:
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return None


def _expected(content: dict[str, Any], section: str, key: str, value: Value) -> dict[str, Any]:
    inner = dict(content.get(section) or {})
    inner.pop(key, None)
    if value is not None:
        inner[key] = value
    rest = {name: part for name, part in content.items() if name != section}
    return rest | {section: inner} if inner or (section in content and value) else rest


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
