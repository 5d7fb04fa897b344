"""Reader of the truth's sections in a configuration: what a section's own types do not say.

An error is one sentence that names the key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, TypeVar

from calib.target import InputMismatch, StarTarget
from simulators.errors import ConfigError
from simulators.reading import Pair, read, read_section
from simulators.world.gimbal import GimbalTruth
from simulators.world.truth import (
    CAMERAS,
    COLLIMATORS,
    LARGEST_FOCAL_MM,
    NOISE_LEVELS,
    CameraTruth,
    CollimatorTruth,
    LensTruth,
    MountTruth,
    NoiseTruth,
    OpticsTruth,
    ReticleTruth,
    ThermalTruth,
    Truth,
)

_Kind = TypeVar("_Kind")

_LARGEST_SIDE: Final = 8192  # Both bound the memory of a simulated sensor
_MOST_PIXELS: Final = 1 << 24  # 16 times 1280 x 720


def truth_from_config(config: Mapping[str, Any]) -> Truth:
    """Read the truth from the optional sections that are named as the attributes of `Truth`; ignore other sections.

    ``target`` describes the print with the keys of `StarTarget`, its two numbers of squares as ``squares``. ``noise``
    is the name of a level, or a mapping over the typical level. ``collimator`` may be the name of a profile, or a
    mapping that names it as ``profile`` beside the keys that differ from it. ``scale`` and ``backlash_deg`` of the
    ``gimbal`` are numbers for all axes, or mappings by axis. `ConfigError` names a key that is unknown or not valid.

    >>> truth_from_config({"collimator": {"r": 700}, "noise": "clean"}).collimator.r
    700.0
    """
    noise = _noise(config.get("noise", "typical"))
    target = _target(config.get("target", {}))
    camera = _camera(config.get("camera", {}))
    return Truth(
        camera=camera,
        lens=_lens(config.get("lens", {}), camera),
        collimator=_collimator(config.get("collimator", {}), target),
        reticle=read_section(ReticleTruth, config.get("reticle", {}), "reticle"),
        optics=read_section(OpticsTruth, config.get("optics", {}), "optics"),
        noise=noise,
        thermal=read_section(ThermalTruth, config.get("thermal", {}), "thermal"),
        mount=read_section(MountTruth, config.get("mount", {}), "mount"),
        gimbal=read_section(GimbalTruth, config.get("gimbal", {}), "gimbal"),
        target=target,
    )


def _noise(given: object) -> NoiseTruth:
    """Read a level of noise by its name, or a mapping over the typical level."""
    if not isinstance(given, str):
        return read_section(NoiseTruth, given, "noise")
    return _profile(NOISE_LEVELS, given, "noise level", "noise")


def _profile(known: Mapping[str, _Kind], name: object, what: str, where: str) -> _Kind:
    """Return one of several sets of values, by its name."""
    if not isinstance(name, str) or name not in known:
        raise ConfigError(f"Unknown {what} {name!r}.", where=where, remedy=f"Use one of: {', '.join(known)}.")
    return known[name]


def _camera(given: object) -> CameraTruth:
    """Read the section of the camera; the defaults depend on the lens's projection."""
    kind = given.get("projection", "pinhole") if isinstance(given, Mapping) else "pinhole"
    camera = read_section(
        CameraTruth, given, "camera", _profile(CAMERAS, kind, "lens projection", "camera.projection")
    )
    if max(camera.width, camera.height) > _LARGEST_SIDE or camera.width * camera.height > _MOST_PIXELS:
        raise ConfigError(
            f"A sensor of {camera.width} x {camera.height} px cannot be simulated.",
            where="camera.width",
            remedy=f"Give sides of at most {_LARGEST_SIDE} px, and at most {_MOST_PIXELS} px together.",
        )
    for name in ("p1", "p2") if kind == "fisheye" else ("k4",):
        if getattr(camera, name) != 0.0:
            raise ConfigError(f"A {kind} lens has no {name}.", where=f"camera.{name}", remedy="Remove it.")
    return camera


def _lens(given: object, camera: CameraTruth) -> LensTruth:
    """Read the section of the lens: focus, aperture and pixels."""
    lens = read_section(LensTruth, given, "lens")
    focal_mm = lens.pixel_um * 1e-3 * 0.5 * (camera.fx + camera.fy)
    if given and focal_mm > LARGEST_FOCAL_MM:
        raise ConfigError(
            f"A lens of {focal_mm:.0f} mm (fx of the camera times pixel_um) is too long for this focus ring.",
            where="lens.pixel_um",
            remedy=f"Give the side of a pixel in um, so that the focal length is at most {LARGEST_FOCAL_MM:.0f} mm.",
        )
    return lens


def _target(given: object) -> StarTarget:
    """Read the section of the printed pattern."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where="target")
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key in {"squares", "tag_square"}:
            values[key] = tuple(int(side) for side in read(Pair, value, f"target.{key}"))
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


def _collimator(given: object, target: StarTarget) -> CollimatorTruth:
    """Read the collimator: a profile and the keys that differ; its axis is as far from the tag as by default."""
    if isinstance(given, str):
        given = {"profile": given}
    name, rest = "ideal", given
    if isinstance(given, Mapping):
        name, rest = given.get("profile", name), {k: v for k, v in given.items() if k != "profile"}
    profile = _profile(COLLIMATORS, name, "collimator profile", "collimator.profile")
    collimator = read_section(CollimatorTruth, rest, "collimator", profile)
    if target == StarTarget() or not isinstance(rest, Mapping):
        return collimator
    standard, own = StarTarget().tag_centre_mm, target.tag_centre_mm
    return replace(
        collimator,
        x=collimator.x if "x" in rest else profile.x - standard[0] + own[0],
        y=collimator.y if "y" in rest else profile.y - standard[1] + own[1],
    )
