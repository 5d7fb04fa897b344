"""Software that a station brings into a run, besides Starbench: packages of plug-ins, and libraries of its drivers.

A verification may run on a computer without these packages. So `results_content.other_software` does not compare them,
and a run that cannot be read without a plug-in is told as not compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

from bench.results.results_content import software
from bench.stations.plugins import GROUPS, Plugin, plugins
from bench.stations.station import Station

_LIBRARIES: Final = {"neuromorphic_evk4": "neuromorphic-drivers"}
"""Package that a built-in driver needs, by the name of the driver."""
_READERS: Final = {
    ".aedat4": "aedat",
    ".bag": "rosbags",
    ".db3": "rosbags",
    ".mcap": "rosbags",
}
"""Package that reads recordings of others, by the ending of the file."""
_NOT_STATED: Final = "not stated"


def run_software(station: Station) -> dict[str, str]:
    """Return the versions of all software that contributes to a run on a station.

    Returns: `software`, and the version of each package of a plug-in and of each optional library that the
      station uses.
    """
    brought = {plugin.distribution: plugin.version for plugin in _used(station)}
    library = _LIBRARIES.get(_driver(station.camera))
    return _joined({**brought, **_versions([library] if library is not None else [])})


def files_software(endings: Iterable[str]) -> dict[str, str]:
    """Return the versions of all software that contributes to an offline calibration.

    Returns: `software`, and the version of each optional library that reads such a file.
    """
    return _joined(_versions({_READERS[ending.lower()] for ending in endings if ending.lower() in _READERS}))


def plugins_of_run(station: Station) -> dict[str, dict[str, list[str]]]:
    """Return the plug-ins that a station uses, as ``run_started`` states them.

    Returns: ``plugins``: for each package the kinds and names of its drivers in this station, ``["stage
      turntable"]``; empty if the station uses none.
    """
    found: dict[str, list[str]] = {}
    for plugin in _used(station):
        found.setdefault(plugin.distribution, []).append(f"{plugin.kind} {plugin.name}")
    return {"plugins": found} if found else {}


def plugins_stated(started: Mapping[str, Any]) -> dict[str, str]:
    """Return the plug-ins that a run used, by its journal.

    started: First line of the journal, or ``run`` of results.json.
    Returns: Package and version, and the drivers that it brought: ``{"starbench-turntable 1.0": "stage
      turntable"}``.
    """
    versions = started.get("software") or {}
    return {
        f"{name} {versions.get(name, _NOT_STATED)}": ", ".join(drivers)
        for name, drivers in (started.get("plugins") or {}).items()
    }


def plugins_missing(started: Mapping[str, Any]) -> list[str]:
    """Return the plug-ins of a run that this computer does not have, or not in the version of the run.

    started: First line of the journal.
    """
    here = {plugin.package for kind in GROUPS for plugin in plugins(kind) if not plugin.trouble}
    return [package for package in plugins_stated(started) if package not in here]


def _used(station: Station) -> Iterator[Plugin]:
    for kind in GROUPS:
        section = type(getattr(station, kind))
        for plugin in plugins(kind):
            if plugin.section is section and plugin.distribution:
                yield plugin


def _driver(section: object) -> str:
    return str(getattr(section, "driver", ""))


def _versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of packages; one that is missing has taken no part."""
    found = {}
    for name in sorted(packages):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _joined(more: Mapping[str, str]) -> dict[str, str]:
    """Return `software` with further packages, which never replace an entry of it."""
    own = software()
    return own | {name: stated for name, stated in more.items() if name not in own}
