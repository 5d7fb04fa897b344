"""Reader of the truth's sections in a configuration: each key is checked, then replaces a default of `truth`.

It checks names, types and ranges; an error is one sentence that names the key.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Final, TypeVar

from calib.target import InputMismatch, StarTarget
from simulators.errors import ConfigError
from simulators.world.board_config import board_from_config
from simulators.world.gimbal import AXES, GimbalTruth
from simulators.world.lens_config import lens_from_config
from simulators.world.placing import check_placements, field_tangents
from simulators.world.truth import (
    CAMERAS,
    COLLIMATORS,
    NOISE_LEVELS,
    POLARITIES,
    CameraTruth,
    CollimatorTruth,
    MountTruth,
    NoiseTruth,
    OpticsTruth,
    ReticleTruth,
    ScreenTruth,
    ThermalTruth,
    Truth,
)

_Section = TypeVar(
    "_Section",
    CameraTruth,
    CollimatorTruth,
    ReticleTruth,
    OpticsTruth,
    NoiseTruth,
    ThermalTruth,
    MountTruth,
    GimbalTruth,
    ScreenTruth,
)


def truth_from_config(config: Mapping[str, Any]) -> Truth:
    """Read the truth from the sections of a configuration that are named as the attributes of `Truth`.

    config: Every section and every key in it is optional; other sections are ignored. ``target`` describes
      the print with the keys of `StarTarget`, its two numbers of squares as ``squares``. ``noise`` is the
      name of a level, or a mapping over the typical level. ``collimator`` may be the name of a profile, or a
      mapping that names it as ``profile`` beside the keys that differ from it. ``scale`` and ``backlash_deg``
      of the ``gimbal`` are numbers for all axes, or mappings by axis.
    Raises ConfigError: If a key is unknown, or its value is not a finite number in its range; the error names
      the key.

    Examples
    --------
    >>> truth_from_config({"collimator": {"r": 700}, "noise": "clean"}).collimator.r
    700.0
    """
    noise = config.get("noise", "typical")
    if isinstance(noise, str):
        if noise not in NOISE_LEVELS:
            names = ", ".join(NOISE_LEVELS)
            raise ConfigError(
                f"Unknown noise level {noise!r}.", where="noise", remedy=f"Use one of: {names}."
            )
        level = NOISE_LEVELS[noise]
    else:
        level = _section("noise", NoiseTruth(), noise)
    target = _target(config.get("target", {}))
    camera = _camera(config.get("camera", {}))
    screen, board = _screen(config.get("screen", {})), board_from_config(config.get("board", {}))
    if board.present:
        board = dataclasses.replace(board, field_tangents=field_tangents(camera))
    if screen.columns and board.present:
        raise ConfigError(
            "There is a screen and a board.", where="board", remedy="Remove one of the two sections."
        )
    truth = Truth(
        camera=camera,
        lens=lens_from_config(config.get("lens", {}), camera),
        collimator=_collimator(config.get("collimator", {}), target),
        reticle=_reticle(config.get("reticle", {})),
        optics=_section("optics", OpticsTruth(), config.get("optics", {})),
        noise=level,
        thermal=_section("thermal", ThermalTruth(), config.get("thermal", {})),
        mount=_section("mount", MountTruth(), config.get("mount", {})),
        gimbal=_gimbal(config.get("gimbal", {})),
        screen=screen,
        board=board,
        target=target,
    )
    check_placements(truth)
    return truth


def _gimbal(given: object) -> GimbalTruth:
    """Read the section of the gimbal; two of its keys may differ between the axes."""
    if isinstance(given, Mapping):
        given = {
            key: _by_axis(value, f"gimbal.{key}") if key in {"scale", "backlash_deg"} else value
            for key, value in given.items()
        }
    gimbal = _section("gimbal", GimbalTruth(), given)
    for name, play in zip(AXES, gimbal.backlash_deg, strict=True):
        if play < 0.0:
            raise ConfigError(
                f"{play!r} is negative.",
                where=f"gimbal.backlash_deg.{name}",
                remedy="Give a number of at least 0.",
            )
    for name, scale in zip(AXES, gimbal.scale, strict=True):
        if abs(scale) > _LARGEST_SCALE:
            raise ConfigError(
                f"{scale!r} is no small error of a scale.",
                where=f"gimbal.scale.{name}",
                remedy="Give the relative error: 0.001 turns 6 degrees into 6.006.",
            )
    return gimbal


def _by_axis(value: object, where: str) -> object:
    """Return three numbers, for pan, tilt and roll, from one number or from a mapping by axis."""
    if not isinstance(value, Mapping):
        return (_number(value, where),) * len(AXES)
    for name in value:
        if name not in AXES:
            raise ConfigError(
                "Unknown axis.", where=f"{where}.{name}", remedy=f"Known are: {', '.join(AXES)}."
            )
    return tuple(_number(value.get(name, 0.0), f"{where}.{name}") for name in AXES)


def _screen(given: object) -> ScreenTruth:
    """Read the section of the screen."""
    screen = _section("screen", ScreenTruth(), given)
    if screen.columns == 0:
        if given:
            raise ConfigError(
                "The board has no columns.",
                where="screen.columns",
                remedy="Give the number of inner corners.",
            )
        return screen
    if screen.position_mm[2] <= 0.0:
        raise ConfigError(
            "The screen is not in front of the camera.",
            where="screen.position_mm",
            remedy="Give a positive third number.",
        )
    for name in ("columns", "rows"):
        if getattr(screen, name) < 2:
            raise ConfigError(
                "A board needs at least 2 inner corners along each side.", where=f"screen.{name}"
            )
    return screen


def _camera(given: object) -> CameraTruth:
    """Read the section of the camera; the defaults depend on the lens's projection."""
    kind = given.get("projection", "pinhole") if isinstance(given, Mapping) else "pinhole"
    if not isinstance(kind, str) or kind not in CAMERAS:
        names = ", ".join(CAMERAS)
        raise ConfigError(
            f"Unknown lens projection {kind!r}.", where="camera.projection", remedy=f"Use one of: {names}."
        )
    camera = _section("camera", CAMERAS[kind], given)
    if max(camera.width, camera.height) > _LARGEST_SIDE or camera.width * camera.height > _MOST_PIXELS:
        raise ConfigError(
            f"A sensor of {camera.width} x {camera.height} px cannot be simulated.",
            where="camera.width",
            remedy=f"Give sides of at most {_LARGEST_SIDE} px, and at most {_MOST_PIXELS} px together.",
        )
    for name in ("fx", "fy"):
        if not _SHORTEST_PX <= getattr(camera, name) <= _LONGEST_PX:
            raise ConfigError(
                f"{getattr(camera, name)!r} px is no focal length.",
                where=f"camera.{name}",
                remedy=f"Give a number from {_SHORTEST_PX:g} to {_LONGEST_PX:g}.",
            )
    foreign = ("p1", "p2") if kind == "fisheye" else ("k4",)
    for name in foreign:
        if getattr(camera, name) != 0.0:
            raise ConfigError(f"A {kind} lens has no {name}.", where=f"camera.{name}", remedy="Remove it.")
    return camera


def _target(given: object) -> StarTarget:
    """Read the section of the printed pattern."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where="target")
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key in {"squares", "tag_square"}:
            pair = _like((0.0, 0.0), value, f"target.{key}")
            values[key] = tuple(int(number) for number in pair) if isinstance(pair, tuple) else pair
        elif key in {"pitch_mm", "segments", "tag_id", "tag_squares", "tag_family"}:
            values[key] = value
        else:
            raise ConfigError("Unknown key.", where=f"target.{key}")
    if "squares" in values:
        values["squares_x"], values["squares_y"] = values.pop("squares")
    try:
        return StarTarget(**values)
    except (InputMismatch, TypeError) as error:
        raise ConfigError(f"No such target can be printed: {error}", where="target") from error


def _reticle(given: object) -> ReticleTruth:
    """Read the section of the print's errors."""
    reticle = _section("reticle", ReticleTruth(), given)
    if reticle.polarity not in POLARITIES:
        raise ConfigError(
            f"Unknown polarity {reticle.polarity!r}.",
            where="reticle.polarity",
            remedy=f"Use one of: {', '.join(POLARITIES)}.",
        )
    return reticle


def _collimator(given: object, target: StarTarget) -> CollimatorTruth:
    """Read the section of the collimator: a profile, and keys that differ from it.

    Unless it says where, the axis meets the target as far from the tag's centre as on the standard target.
    """
    if isinstance(given, str):
        given = {"profile": given}
    name, rest = "ideal", given
    if isinstance(given, Mapping):
        name, rest = given.get("profile", name), {k: v for k, v in given.items() if k != "profile"}
    if not isinstance(name, str) or name not in COLLIMATORS:
        names = ", ".join(COLLIMATORS)
        raise ConfigError(
            f"Unknown collimator profile {name!r}.",
            where="collimator.profile",
            remedy=f"Use one of: {names}.",
        )
    collimator, profile = _section("collimator", COLLIMATORS[name], rest), COLLIMATORS[name]
    if target == StarTarget() or not isinstance(rest, Mapping):
        return collimator
    standard, own = StarTarget().tag_centre_mm, target.tag_centre_mm
    return dataclasses.replace(
        collimator,
        x=collimator.x if "x" in rest else profile.x - standard[0] + own[0],
        y=collimator.y if "y" in rest else profile.y - standard[1] + own[1],
    )


def _section(name: str, default: _Section, given: object) -> _Section:
    """Return ``default`` with the given keys replaced, each checked against the type of its default."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where=name)
    known = {f.name: getattr(default, f.name) for f in dataclasses.fields(default)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        where = f"{name}.{key}"
        if key not in known:
            raise ConfigError("Unknown key.", where=where, remedy=f"Known are: {', '.join(known)}.")
        values[key] = _like(known[key], value, where)
    return dataclasses.replace(default, **values)


def _like(default: object, value: object, where: str) -> object:
    """Check a value, and convert it to its default's type (float, int or a tuple of floats)."""
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or len(value) != len(default):
            raise ConfigError(f"{len(default)} numbers are expected, not {value!r}.", where=where)
        return tuple(_number(v, where) for v in value)
    if isinstance(default, str):
        return value  # checked by the reader of its section
    number = _number(value, where)
    if isinstance(default, int):
        if number != int(number) or number < 1:
            raise ConfigError(f"A whole number of at least 1 is expected, not {value!r}.", where=where)
        return int(number)
    if where in _POSITIVE and number <= 0:
        raise ConfigError(f"{value!r} is not positive.", where=where, remedy="Give a positive number.")
    if where in _NOT_NEGATIVE and number < 0:
        raise ConfigError(f"{value!r} is negative.", where=where, remedy="Give a number of at least 0.")
    return number


_LARGEST_SCALE: Final = 0.2
"""Largest relative error of an axis's scale; larger numbers are factors that were given by mistake."""

_LARGEST_SIDE: Final = 8192
_MOST_PIXELS: Final = 1 << 24
_SHORTEST_PX, _LONGEST_PX = 1.0, 1e6

_POSITIVE: Final = {
    "screen.square_mm",
    "camera.fx",
    "camera.fy",
    "collimator.r",
    "collimator.half_angle_deg",
    "reticle.bow_radius_mm",
}
_NOT_NEGATIVE: Final = {
    "collimator.rim",
    "collimator.disc_wander_mm",
    "collimator.disc_breathing",
    "collimator.disc_unevenness",
    "collimator.irregularity_mm",
    "collimator.rim_irregularity_mm",
    "collimator.glass_change",
    "gimbal.wobble_deg",
    "gimbal.eccentricity_deg",
    "gimbal.reading_sigma_deg",
    "optics.psf_px",
    "optics.psf_rim_px",
    "optics.black",
    "optics.stray",
    "thermal.warm_up_min",
    "mount.vibration_arcsec",
    "mount.vibration_hz",
    *(f"noise.{f.name}" for f in dataclasses.fields(NoiseTruth)),
}


def _number(value: object, where: str) -> float:
    """Check that it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ConfigError(f"A finite number is expected, not {value!r}.", where=where)
    return float(value)
