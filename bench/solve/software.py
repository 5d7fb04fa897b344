"""The software that a run states: program, engine, libraries and plug-ins.

A verification may run on a computer without plug-ins and the libraries of drivers. So these are not compared
(`bench.solve.results_content.other_software`), and a run that cannot be read without a plug-in is told as such.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from bench.base.program import installed_versions
from bench.record.events import RunStarted
from bench.solve.results_content import software
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
    """Return `software`, and versions of plug-ins and optional libraries that the station uses."""
    brought = {plugin.distribution: plugin.version for plugin in used_plugins(station)}
    library = _LIBRARIES.get(getattr(station.camera, "driver", ""))
    own = software()  # whose entries no package replaces
    return own | brought | installed_versions([library] if library is not None else []) | own


def files_software(endings: Iterable[str]) -> dict[str, str]:
    """Return `software`, and the version of each optional library that reads files with such endings."""
    readers = {_READERS[ending.lower()] for ending in endings if ending.lower() in _READERS}
    return software() | installed_versions(sorted(readers))


def plugins_of_run(station: Station) -> dict[str, dict[str, list[str]]]:
    """Return ``plugins`` of a station as ``run_started`` has them, ``["stage epics_motor"]`` a package; or nothing."""
    by_distribution: dict[str, list[str]] = {}
    for plugin in used_plugins(station):
        by_distribution.setdefault(plugin.distribution, []).append(f"{plugin.kind} {plugin.name}")
    return {"plugins": by_distribution} if by_distribution else {}


def plugins_stated(started: RunStarted) -> dict[str, str]:
    """Return the plug-ins that a run used, by its journal: ``{"starbench-epics 1.0": "stage epics_motor"}``."""
    versions = started.get("software") or {}
    return {
        f"{name} {versions.get(name, _NOT_STATED)}": ", ".join(drivers)
        for name, drivers in (started.get("plugins") or {}).items()
    }


def plugins_missing(started: RunStarted) -> list[str]:
    """Return the plug-ins of a run that this computer does not have, or not in the version of the run."""
    here = {plugin.package for kind in GROUPS for plugin in plugins(kind) if not plugin.trouble}
    return [package for package in plugins_stated(started) if package not in here]


def used_plugins(station: Station) -> Iterator[Plugin]:
    """List the plug-ins that the sections of a station name."""
    for kind in GROUPS:
        section = type(getattr(station, kind))
        for plugin in plugins(kind):
            if plugin.section is section and plugin.distribution:
                yield plugin
