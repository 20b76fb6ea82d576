"""Loading and resolving: defaults, then config.yaml, then the site file, then overrides."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roadsight.base.engines import open3d
from roadsight.base.errors import InputError
from roadsight.base.section import check_path, validated
from roadsight.base.texts import read_yaml
from roadsight.config.plans import Plan, check_sensors, load_plans
from roadsight.config.schema import Config, Settings
from roadsight.config.sites import Site
from roadsight.effects.catalogue import check_names, load_catalogue
from roadsight.io.records.companions import split_layer

SITES = Path("config/sites")  # where sites are that are named without a path


@dataclass(frozen=True)
class ResolvedSite:
    """A site with its final settings and paths.

    Parameters
    ----------
    site : the site file's content. settings : all settings, the site's overrides applied.
    file : where it was read. clouds : the cloud files. plans : the plans to solve, by name.
    """

    site: Site
    settings: Settings
    file: Path
    clouds: list[str]
    plans: dict[str, Plan]

    def setting(self, path: str) -> Any:
        """Value of a dotted setting such as ``ground.slope``."""
        value: Any = self.settings
        for part in path.split("."):
            value = getattr(value, part)
        return value

    def beside(self, path: str | None) -> str | None:
        """Path of a file that the site file names, relative to it, with variables replaced."""
        return None if path is None else str(_located(split_layer(path)[0], self.file))

    def layered(self, path: str) -> str:
        """The same with the layer that the site file names, ``file.gpkg|layername=edges``."""
        return str(_located(path, self.file))


def load_config(content: dict[str, Any], where: str = "config/config.yaml") -> Config:
    """Check the merged configuration."""
    return validated(Config, content, where)


def load_sites(config: Config) -> dict[str, ResolvedSite]:
    """All sites of the configuration by their names.

    Raises
    ------
    InputError : as `load_site`, or two files name the same site.
    """
    sites: dict[str, ResolvedSite] = {}
    for name in config.sites:
        resolved = load_site(name, config)
        known = sites.setdefault(resolved.site.site, resolved)
        if known is not resolved:
            raise InputError(
                f"two site files name the same site {resolved.site.site!r}",
                where=f"{known.file}, {resolved.file}",
                hint="give each a name of its own: results go to results/<site>",
            )
    return sites


def check_engines(sites: Mapping[str, ResolvedSite]) -> None:
    """Check before any work that what sites ask to be done by Open3D can be done by it.

    Raises
    ------
    InputError : a setting asks for it, and it or a system library that it needs is missing.
    """
    for resolved in sites.values():
        for section, values in resolved.settings.model_dump().items():
            for name, value in values.items() if isinstance(values, dict) else ():
                if name.endswith("engine") and value == "open3d":
                    open3d(f"{resolved.file}: {section}.{name}")


def load_site(name: str, config: Config) -> ResolvedSite:
    """Read a site by name (``config/sites/<name>.yaml``) or by the path of its file.

    Raises
    ------
    InputError : no such site, or anything wrong in its file, the plans or the sensors.
    """
    file = Path(name) if name.endswith((".yaml", ".yml")) else SITES / f"{name}.yaml"
    if not file.is_file():
        known = sorted(path.stem for path in SITES.glob("*.yaml"))
        raise InputError(
            f"no site file {file}",
            where=f"site {name}",
            allowed=", ".join(known) or None,
            hint="write one with 'roadsight init CLOUD'",
        )
    return resolve_site(read_yaml(file), file, config)


def resolve_site(content: Any, file: Path, config: Config) -> ResolvedSite:
    """A site from what its file says or is to say.

    Parameters
    ----------
    content : of the site file. file : where it lies.

    Raises
    ------
    InputError : anything wrong in it, the plans or the sensors.
    """
    site = validated(Site, content, str(file))
    base = config.model_dump(include=set(Settings.model_fields))
    settings = validated(Settings, merged(base, site.settings), f"{file}: settings")
    settings = validated(Settings, merged(settings.model_dump(), config.overrides), "overrides")
    check_names(settings.effect_modes, load_catalogue(config.effects_file), f"{file}: effects")
    own_plans, plans_file = site.placement.own_plans, Path(config.plans_file)
    general = load_plans(config.plans_file, config.sensors_file)
    check_sensors(own_plans, config.sensors_file, f"{file}: placement.own_plans")
    plans = {
        name: plan.located(lambda path: str(_located(path, plans_file)))
        for name, plan in general.items()
    } | {
        name: plan.located(lambda path: str(_located(path, file)))
        for name, plan in own_plans.items()
    }
    everyday = [name for name, plan in plans.items() if not plan.on_request]
    named = site.placement.plans if site.placement.plans is not None else everyday
    _check_plans(named, plans, f"{file}: placement.plans")
    own = [name for name, plan in own_plans.items() if not plan.on_request]
    chosen = list(dict.fromkeys([*named, *own]))
    if config.plans:
        chosen = config.plans
        _check_plans(chosen, plans, "plans")
    solved = {name: plans[name] for name in chosen}
    for setting in ("solver", "verify"):
        for name, plan in solved.items():
            if getattr(settings.cover, setting) == "highs" and plan.availability is not None:
                raise InputError(
                    f"highs cannot state the availability of plan {name!r} in one program",
                    where=f"cover.{setting}",
                    hint=f"leave cover.{setting} out, or the plan's availability",
                )
    clouds = [str(_located(cloud, file)) for cloud in site.clouds]
    return ResolvedSite(site, settings, file, clouds, solved)


def _check_plans(chosen: list[str], plans: dict[str, Plan], where: str) -> None:
    if not chosen:
        raise InputError("names no plan", where=where, allowed=", ".join(plans))
    for name in chosen:
        if name not in plans:
            raise InputError(f"unknown plan {name!r}", where=where, allowed=", ".join(plans))


def merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with the values of ``override``, section by section."""
    result = dict(base)
    for key, value in override.items():
        both = isinstance(value, Mapping) and isinstance(base.get(key), Mapping)
        result[key] = merged(base[key], value) if both else value
    return result


def _located(path: str, file: Path) -> Path:
    """Absolute as given; relative to the site file; ``${VARIABLE}`` from the environment."""

    def value(match: re.Match[str]) -> str:
        if not os.environ.get(match[1]):
            raise InputError(
                f"environment variable {match[1]} is not set",
                where=f"{file}: {path}",
                hint=f"export {match[1]}=<folder> and run again",
            )
        return os.environ[match[1]]

    found = Path(re.sub(r"\$\{(\w+)\}", value, path))
    check_path(found, str(file))
    return found if found.is_absolute() else Path(os.path.normpath(file.parent / found))
