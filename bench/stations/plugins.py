"""Plug-ins: drivers that packages of others bring, by entry points, with their sections of a station file.

Groups are ``starbench.stages``, ``starbench.lights`` and ``starbench.cameras``; the name of an entry
point is the name of the driver, and its object is the section's class (`bench.stations.sections`). A
plug-in that cannot be loaded is named where a station file uses it, and by `starbench devices`; it breaks
no other station. docs/plugins.md explains it.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, Union

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    create_model,
    model_validator,
)

from bench.stations.sections import (
    EventCameraSection,
    FrameCameraSection,
    LightSection,
    StageSection,
)
from sequences.strict_model import StrictModel

Kind = Literal["stage", "light", "camera"]
GROUPS: Final[dict[Kind, str]] = {
    "stage": "starbench.stages",
    "light": "starbench.lights",
    "camera": "starbench.cameras",
}
_BASES: Final[dict[Kind, tuple[type[StrictModel], ...]]] = {
    "stage": (StageSection,),
    "light": (LightSection,),
    "camera": (EventCameraSection, FrameCameraSection),
}


@dataclass(frozen=True)
class Plugin:
    """One entry point of a package."""

    kind: Kind
    name: str
    package: str
    section: type[StrictModel] | None  # Class of the section; None if it cannot be used
    trouble: str = ""  # Why it cannot be used; empty if it can
    distribution: str = ""  # Name of the package; empty if no package is known
    version: str = ""  # Version of the package; empty if no package is known


@functools.cache
def _brought() -> Mapping[Kind, Sequence[EntryPoint]]:
    """Return the entry points of packages by kind; to read those of one kind takes as long as to read all."""
    every = entry_points()
    return {kind: tuple(every.select(group=group)) for kind, group in GROUPS.items()}


@functools.cache
def plugins(kind: Kind) -> tuple[Plugin, ...]:
    """Load the plug-ins of a kind, by name, once a process. No exception of a plug-in passes through."""
    by_name: dict[str, Plugin] = {}
    for entry in sorted(_brought()[kind], key=lambda entry: entry.name):
        plugin = _load(kind, entry)
        if (other := by_name.get(entry.name)) is not None and other.package != plugin.package:
            trouble = f"two packages bring this driver: {other.package} and {plugin.package}"
            plugin = Plugin(kind, entry.name, plugin.package, None, trouble)
        by_name[entry.name] = plugin
    return tuple(by_name.values())


def with_plugins(
    kind: Kind, built_in: Sequence[type[BaseModel]], taken_out: Mapping[str, str] = MappingProxyType({})
) -> Any:
    """Return the type of a section of the station file: a built-in driver or a plug-in, chosen by its key ``driver``.

    ``taken_out`` holds the names of former drivers, each with the reason why it was taken out.
    """
    taken = {name for section in built_in for name in _driver_names(section)}
    brought = [plugin for plugin in plugins(kind) if plugin.name not in taken]
    models = [
        *built_in,
        *(_broken(addition) if addition.section is None else addition.section for addition in brought),
    ]
    former = {
        name: why for name, why in taken_out.items() if name not in {addition.name for addition in brought}
    }

    def refuse_former(value: Any) -> Any:
        name = value.get("driver") if isinstance(value, Mapping) else None
        if isinstance(name, str) and name in former:
            raise ValueError(f"the driver {name!r} was taken out, {former[name]}")
        return value

    told_apart = Field(discriminator="driver")
    return Annotated[Union[tuple(models)], told_apart, BeforeValidator(refuse_former)]  # noqa: UP007 - made at run time


def _load(kind: Kind, entry: EntryPoint) -> Plugin:
    stated = (entry.dist.name, entry.dist.version) if entry.dist is not None else ("", "")
    package = " ".join(stated) if entry.dist is not None else "an unknown package"
    try:
        section = entry.load()
        trouble = _unfit(kind, entry.name, section)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a plug-in does, other stations must work
        section, trouble = None, f"{type(error).__name__}: {error}"
    return Plugin(kind, entry.name, package, None if trouble else section, trouble, *stated)


def _unfit(kind: Kind, name: str, section: Any) -> str:
    """Return why an object cannot be a section; empty if it can."""
    bases = _BASES[kind]
    listed = " or ".join(base.__name__ for base in bases)
    if not (isinstance(section, type) and issubclass(section, bases)):
        return f"{section!r} is not a class that derives from {listed}"
    if _driver_names(section) != (name,):
        return f"its key driver must be Literal[{name!r}], the name of the entry point"
    if missing := sorted(section.__abstractmethods__):
        return f"it does not implement {', '.join(missing)}"
    section.model_json_schema()  # a field without a schema shows here, not in the middle of a run
    return ""


def _driver_names(section: type[BaseModel]) -> tuple[str, ...]:
    field = section.model_fields.get("driver")
    return typing.get_args(field.annotation) if field is not None else ()


def _broken(plugin: Plugin) -> type[BaseModel]:
    """Return a section that refuses everything, and names the plug-in."""
    what = (
        f"the plug-in {plugin.name!r} of {plugin.package} cannot be used: {plugin.trouble}."
        " Repair or update that package; other drivers work."
    )

    def refuse(_cls: Any, _value: Any) -> Any:
        raise ValueError(what)

    check: Any = model_validator(mode="before")
    driver: Any = Literal[plugin.name]
    made: type[BaseModel] = create_model(
        f"Broken_{plugin.name}",
        __config__=ConfigDict(extra="allow"),
        __doc__=what,
        __validators__={"refuse": check(classmethod(refuse))},
        driver=(driver, ...),
    )
    return made
