"""Configuration of the simulated bench: its devices, and the world they stand in.

This module defines every key, its default and its range; an error is one sentence that names the key. `truth_config`
reads the sections camera, collimator, target, reticle, optics, noise, thermal, mount, gimbal and lens.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BeforeValidator

from simulators.errors import ConfigError
from simulators.faults.catalogue import FaultOrder, fault_order
from simulators.reading import (
    Count,
    NotNegative,
    Number,
    Positive,
    Section,
    Switch,
    Text,
    Whole,
    one_of,
    read,
    read_section,
    text,
)
from simulators.world.gimbal import AXES, GimbalTruth
from simulators.world.truth import ThermalTruth, Truth
from simulators.world.truth_config import truth_from_config
from simulators.world.world import AxisName

#: Kinds of stages, with the usual number of counts per degree.
STAGE_KINDS: Final[Mapping[str, int]] = {
    "zaber": 6400,
    "ximc": 25_600,
    "grbl": 640,
    "esp301": 10_000,
    "flir_ptu": 800,
    "thorlabs_apt": 136_533,
}

#: Kinds of light drivers: makes of function generators, a strobe controller, and a microcontroller.
LIGHT_KINDS: Final = ("keysight", "rigol", "siglent", "gardasoft", "microcontroller")

_PORTS: Final = ("pty", "tcp")

_TRUTH_SECTIONS: Final = (
    *("camera", "collimator", "target", "reticle", "optics", "noise", "thermal", "mount", "gimbal"),
    "lens",
)


_MOUNTING_STREAM = 1  # Of random numbers, apart from those of other parts of the world
_MOUNTING_SPREAD_DEG = 0.25  # 1 sigma about each axis, as by eye (own choice)
_MOUNTING_DEG = (0.0, 0.0, 10.0)
"""With a roll, as on a real bench: the print's edges are then not parallel to the rows of pixels."""

_ENDS: Final = {"zaber": b"\n", "grbl": b"\n", "esp301": b"\r", "flir_ptu": b" "}
"""Ends of messages, by kind of stage; the messages of other kinds are written in hexadecimal digits."""


@dataclass(frozen=True)
class AxisConfig(Section):
    """One axis of the gimbal."""

    serial: Text
    # Soft limit in both directions, as the controller is delivered; the end stops are 2 degrees further out.
    limit_deg: Positive
    start_deg: Number = 0.0
    microsteps_per_deg: Count = 6400
    speed_deg_s: Positive = 40.0
    acceleration_deg_s2: Positive = 200.0
    settle_s: NotNegative = 0.02  # Time constant of the load settling after a move
    backlash_deg: NotNegative = 0.0  # Play of the gear; section ``gimbal`` may give it instead
    encoder: Switch = True  # Whether there is an encoder on the shaft


_ROLL: Final = AxisConfig("100103", 180.0)


@dataclass(frozen=True)
class LightConfig(Section):
    """The light's driver."""

    kind: Annotated[str, one_of(LIGHT_KINDS), BeforeValidator(text)] = "keysight"
    serial: Text = "SG0042"  # Its serial number, if it has one
    error_queue: Switch = True  # Whether it answers ``SYST:ERR?``, for instruments that may or may not
    # What another program left behind, words of `simulators.lights.driver.LightDriver.LEFT` separated by blanks.
    left_behind: Text = ""
    idle_s: NotNegative = 0.0  # Time after which a TCP line closes an idle connection, s; 0: never


@dataclass(frozen=True)
class Night(ThermalTruth):
    """Conditions of a night, the camera's temperature among them: section ``rehearsal``."""

    room_c: Number = 22.0
    warm_up_min: NotNegative = 20.0
    covered_share: NotNegative = 0.0  # Share of the recordings in which something covers the camera's view
    lost_share: NotNegative = 0.0  # Share of the recordings that the camera does not complete
    star_sigma_px: NotNegative = 0.03  # Noise of a star's centre, in x and in y, 1 sigma


@dataclass(frozen=True)
class BenchConfig:
    """A whole simulated bench."""

    # Parameters of the world, before the mounting is drawn from the seed.
    truth: Truth = field(default_factory=Truth)
    stage_kind: str = "zaber"
    stage_left_behind: tuple[bytes, ...] = ()  # Messages that another program has sent to the stage's ports
    axes: Mapping[AxisName, AxisConfig] = field(
        default_factory=lambda: {
            "pan": AxisConfig("100101", 15.0, start_deg=2.4),
            "tilt": AxisConfig("100102", 10.0, start_deg=-1.7),
        }
    )
    light: LightConfig = field(default_factory=LightConfig)
    night: Night = field(default_factory=Night)  # Of rehearsals alone
    faults: tuple[FaultOrder, ...] = ()
    camera_serial: str = "00050423"
    # Seed of the camera's fixed pattern (thresholds, hot pixels); None: drawn from the bench's seed.
    camera_seed: int | None = None
    # Whether the camera's mounting on the gimbal is drawn from the bench's seed, about half a degree around a
    # roll of 10 degrees, instead of taken from ``truth``. Stars of benches with different seeds then fall
    # differently on pixels.
    mounting_from_seed: bool = True
    ports: str = "pty" if hasattr(os, "openpty") else "tcp"  # Transport of the serial lines: "pty" or "tcp"
    paced: bool = True  # Whether bytes are delayed as by the line's baud rate

    def truth_for(self, seed: int) -> Truth:
        """Return the truth of a bench, with the axes' backlash; the seed may draw mounting and gimbal errors."""
        gimbal, axes = self.truth.gimbal, self.axes
        pan, tilt, roll = (axes[name].backlash_deg if name in axes else 0.0 for name in AXES)
        gimbal = replace(gimbal, seed=gimbal.seed or seed, backlash_deg=(pan, tilt, roll))
        truth = replace(self.truth, gimbal=gimbal)
        if not self.mounting_from_seed:
            return truth
        drawn = np.random.default_rng((seed, _MOUNTING_STREAM)).normal(_MOUNTING_DEG, _MOUNTING_SPREAD_DEG)
        return replace(truth, optics=replace(truth.optics, mounting_deg=tuple(drawn.tolist())))


def bench_config(given: Mapping[str, Any]) -> BenchConfig:
    """Read a configuration; `ConfigError` names a key that is unknown or whose value is not valid.

    All sections are optional: those of `truth`; ``stage``, a mapping of the axes pan, tilt and roll in the order of
    their addresses (pan and tilt are always there), with optional ``kind`` and ``left_behind``; ``light``;
    ``rehearsal``; ``faults``, a list of fault orders (see `faults`) that are carried out from the start; and the
    values ``camera_serial``, ``camera_seed``, ``ports`` ("pty" or "tcp") and ``paced`` (whether bytes are delayed as by
    the line's baud rate).

    >>> bench_config({"stage": {"pan": {"limit_deg": 170}}}).axes["pan"].limit_deg
    170.0
    """
    default = BenchConfig()
    known = [*_TRUTH_SECTIONS, "stage", "light", "faults", "camera_serial", "camera_seed", "ports", "paced"]
    known += ["rehearsal"]
    for key in given:
        if key not in known:
            raise ConfigError("Unknown key.", where=str(key), remedy=f"Known are: {', '.join(known)}.")
    optics = given.get("optics", {})
    orders = given.get("faults", [])
    if not isinstance(orders, list) or not all(isinstance(order, Mapping) for order in orders):
        raise ConfigError(
            "A list of mappings is expected.", where="faults", remedy="Give one mapping per fault."
        )
    stage_kind, axes = _stage(given["stage"], default.axes) if "stage" in given else ("zaber", default.axes)
    light = read_section(LightConfig, given.get("light", {}), "light")
    truth = truth_from_config(given)
    camera_serial = read(Text, given.get("camera_serial", default.camera_serial), "camera_serial")
    seed = read(Whole, given["camera_seed"], "camera_seed") if "camera_seed" in given else None
    return BenchConfig(
        truth=truth,
        stage_kind=stage_kind,
        stage_left_behind=_left_behind(stage_kind, given.get("stage", {}).get("left_behind", [])),
        axes=_with_backlash(given.get("stage", {}), axes, truth.gimbal),
        light=light,
        night=_night(given.get("rehearsal", {})),
        faults=tuple(_order(index, order) for index, order in enumerate(orders)),
        camera_serial=camera_serial,
        camera_seed=seed,
        mounting_from_seed="mounting_deg" not in optics,
        ports=read(Annotated[str, one_of(_PORTS)], given.get("ports", default.ports), "ports"),
        paced=read(Switch, given.get("paced", True), "paced"),
    )


def _with_backlash(
    stage: Mapping[str, Any], axes: Mapping[AxisName, AxisConfig], gimbal: GimbalTruth
) -> Mapping[AxisName, AxisConfig]:
    """Return the axes with the backlash of section ``gimbal``; an axis's own key gives it alike, but not both."""
    play = dict(zip(AXES, gimbal.backlash_deg, strict=True))
    if not any(play.values()):
        return axes
    for name, section in stage.items():
        if isinstance(section, Mapping) and "backlash_deg" in section:
            raise ConfigError(
                "The backlash is given twice, here and in section gimbal.",
                where=f"stage.{name}.backlash_deg",
                remedy="Remove this key, and give gimbal.backlash_deg by axis.",
            )
    return {name: replace(axis, backlash_deg=play[name]) for name, axis in axes.items()}


def _left_behind(kind: str, given: object) -> tuple[bytes, ...]:
    """Read the messages that another program has sent to a stage before the bench was opened."""
    if not isinstance(given, list) or not all(isinstance(mode, str) for mode in given):
        raise ConfigError(
            "A list of texts is expected.", where="stage.left_behind", remedy="Give one message each."
        )
    if kind in _ENDS:
        return tuple(message.encode("ascii", "replace") + _ENDS[kind] for message in given)
    try:
        return tuple(map(bytes.fromhex, given))
    except ValueError as error:
        raise ConfigError(
            "A message is not written in hexadecimal digits.",
            where="stage.left_behind",
            remedy="Write each byte as two digits, such as 10 02 01 02 50 01.",
        ) from error


def _night(given: object) -> Night:
    """Read the conditions of a rehearsed night."""
    night = read_section(Night, given, "rehearsal")
    if night.covered_share + night.lost_share > 1:
        raise ConfigError(
            "covered_share and lost_share add up to more than 1.", where="rehearsal.covered_share"
        )
    return night


def _order(index: int, given: Mapping[str, Any]) -> FaultOrder:
    """Read one fault order of the list."""
    try:
        return fault_order(given)
    except ConfigError as error:
        raise ConfigError(error.what, where=f"faults[{index}].{error.where}", remedy=error.remedy) from error


def _stage(
    given: object, default: Mapping[AxisName, AxisConfig]
) -> tuple[str, Mapping[AxisName, AxisConfig]]:
    """Read the stage's kind and its axes: pan and tilt, with what is given of them, and roll if it is named.

    Their order is that in which they are named if pan and tilt both are.
    """
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where="stage")
    kind = read(Annotated[str, one_of(STAGE_KINDS)], given.get("kind", "zaber"), "stage.kind")
    named = {name: section for name, section in given.items() if name not in {"kind", "left_behind"}}
    if unknown := next((name for name in named if name not in AXES), None):
        raise ConfigError("Unknown axis.", where=f"stage.{unknown}", remedy=f"Known are: {', '.join(AXES)}.")
    steps = STAGE_KINDS[kind]
    names = named if named.keys() >= default.keys() else {**default, **named}
    axes: dict[AxisName, AxisConfig] = {}
    for name in names:
        usual = replace(default.get(name, _ROLL), microsteps_per_deg=steps)
        axis = axes[name] = read_section(AxisConfig, named.get(name, {}), f"stage.{name}", usual)
        if abs(axis.start_deg) > axis.limit_deg:
            raise ConfigError(
                f"{axis.start_deg} lies outside the limits of the axis, +-{axis.limit_deg}.",
                where=f"stage.{name}.start_deg",
            )
        if kind in {"ximc", "thorlabs_apt"} and not axis.serial.isdigit():
            raise ConfigError(
                f"The serial number of a {kind} controller must have digits only.",
                where=f"stage.{name}.serial",
            )
    return kind, axes
