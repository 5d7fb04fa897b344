"""Reader of the truth's sections in a configuration: what a section's own types do not say.

An error is one sentence that names the key.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, TypeVar

import numpy as np

from calib.target import InputMismatch, StarTarget
from simulators.errors import ConfigError
from simulators.reading import Number, Pair, read, read_section
from simulators.world.board import BOARD_KINDS, SURFACES, BoardTruth, check_placements, size_of
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
    ScreenTruth,
    ThermalTruth,
    Truth,
)

_Kind = TypeVar("_Kind")

_LARGEST_SIDE: Final = 8192
_MOST_PIXELS: Final = 1 << 24

_SURFACE_OF: Final = {"checkerboard": "screen", "blinking-dots": "leds"}
_DOT_SHARES: Final = {"circles": 0.5, "asymmetric-circles": 1.0, "blinking-dots": 0.3}
_FIRST_HZ, _LAST_HZ = 200.0, 600.0
_MOST_POINTS: Final = 2000
_MOST_DOTS: Final = 255
_WHOLE_PIXELS: Final = 1e-3


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
    screen, board = _screen(config.get("screen", {})), board_from_config(config.get("board", {}))
    if board.present:
        board = replace(board, field_tangents=_field_tangents(camera), size_mm=size_of(board, target))
    if screen.columns and board.present:
        raise ConfigError(
            "There is a screen and a board.", where="board", remedy="Remove one of the two sections."
        )
    truth = Truth(
        camera=camera,
        lens=_lens(config.get("lens", {}), camera),
        collimator=_collimator(config.get("collimator", {}), target),
        reticle=read_section(ReticleTruth, config.get("reticle", {}), "reticle"),
        optics=read_section(OpticsTruth, config.get("optics", {}), "optics"),
        noise=noise,
        thermal=read_section(ThermalTruth, config.get("thermal", {}), "thermal"),
        mount=read_section(MountTruth, config.get("mount", {}), "mount"),
        gimbal=read_section(GimbalTruth, config.get("gimbal", {}), "gimbal"),
        screen=screen,
        board=board,
        target=target,
    )
    if board.present:
        check_placements(board)
    return truth


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


def _field_tangents(camera: CameraTruth) -> tuple[float, float, float, float]:
    """Return the tangents of the edges of a camera's field of view, without the lens's distortion."""
    return (
        (-0.5 - camera.cx) / camera.fx,
        (-0.5 - camera.cy) / camera.fy,
        (camera.width - 0.5 - camera.cx) / camera.fx,
        (camera.height - 0.5 - camera.cy) / camera.fy,
    )


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


def _screen(given: object) -> ScreenTruth:
    """Read the section of the screen."""
    screen = read_section(ScreenTruth, given, "screen")
    if screen.columns == 0:
        _refuse(
            bool(given), "screen.columns", "The board has no columns.", "Give the number of inner corners."
        )
        return screen
    in_front = screen.position_mm[2] > 0.0
    _refuse(not in_front, "screen.position_mm", "The screen is not in front of the camera.",
            "Give a positive third number.")  # fmt: skip
    for name in ("columns", "rows"):
        few = getattr(screen, name) < 2
        _refuse(few, f"screen.{name}", "A board needs at least 2 inner corners along each side.")
    return screen


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


def board_from_config(given: object) -> BoardTruth:
    """Read the section of the board: the keys of `BoardTruth` over the defaults of its kind; no ``kind`` if empty.

    ``frequencies_hz`` is a list, or a mapping with ``first`` and ``last``. ``placements`` is a list of mappings;
    without it, places are drawn by ``anywhere``. `ConfigError` names a key that is unknown or not valid.

    >>> board_from_config({"kind": "circles", "columns": 9, "rows": 6, "pitch_mm": 25}).dot_mm
    12.5
    """
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where="board")
    if not given:
        return BoardTruth()
    kind = _profile({name: name for name in BOARD_KINDS}, given.get("kind", ""), "value", "board.kind")
    usual = _SURFACE_OF.get(kind, "print")
    surface = _profile(
        {name: name for name in SURFACES}, given.get("surface", usual), "value", "board.surface"
    )
    board = read_section(BoardTruth, {"surface": usual, **given}, "board")
    if kind != "stars":
        _check_grid(board)
    pitch_mm = board.pitch_mm
    board = replace(
        board,
        dot_mm=board.dot_mm if "dot_mm" in given else _DOT_SHARES.get(kind, 0.0) * pitch_mm,
        margin_mm=board.margin_mm
        if "margin_mm" in given
        else (10.0 if kind == "stars" else pitch_mm if surface == "print" else 0.0),
        black=board.black if "black" in given else 0.04 if surface == "print" else 0.0,
    )
    _check_dots(board)
    _check_screen(board, given)
    if board.blinks:
        count = board.columns * board.rows
        frequencies_hz = _frequencies(given.get("frequencies_hz", {}), count)
        phases = _one_each(given.get("phases", [0.0] * count), count, "board.phases")
        return replace(board, frequencies_hz=frequencies_hz, phases=phases)
    for key in ("frequencies_hz", "phases"):
        _refuse(key in given, f"board.{key}", "Only blinking dots have one.", "Remove it.")
    return board


def _check_grid(board: BoardTruth) -> None:
    """Check the number of points and their distance."""
    for key in ("columns", "rows"):
        few = getattr(board, key) < 2
        _refuse(few, f"board.{key}", "A board needs at least 2 points along each side.", "Count the points.")
    many = board.columns * board.rows > _MOST_POINTS
    _refuse(many, "board.columns", f"A board of more than {_MOST_POINTS} points cannot be simulated.")
    _refuse(
        board.pitch_mm <= 0.0, "board.pitch_mm", "The distance of the points is missing.", "Give it in mm."
    )


def _check_dots(board: BoardTruth) -> None:
    """Check that circles do not touch each other."""
    if board.kind not in _DOT_SHARES:
        return
    nearest = board.pitch_mm * (math.sqrt(2.0) if board.kind == "asymmetric-circles" else 1.0)
    touch = not 0.0 < board.dot_mm < nearest
    _refuse(touch, "board.dot_mm", f"Circles of {board.dot_mm:g} mm that are {nearest:g} mm apart touch.",
            "Give a smaller diameter.")  # fmt: skip


def _check_screen(board: BoardTruth, given: Mapping[str, Any]) -> None:
    """Check the keys of a screen."""
    if board.surface != "screen":
        for key in ("pixel_mm", "fill", "refresh_hz", "frames_on", "frames_off", "scan"):
            _refuse(
                key in given, f"board.{key}", f"The surface {board.surface!r} is no screen.", "Remove it."
            )
        return
    _refuse(board.kind != "checkerboard", "board.surface", "A screen shows a checkerboard.",
            "Use surface: print.")  # fmt: skip
    _refuse(board.fill <= 0.0, "board.fill", "A screen without light is not seen.")
    _refuse("scan" in given and not board.refresh_hz, "board.scan",
            "Only a screen with a refresh rate is drawn line by line.", "Give refresh_hz.")  # fmt: skip
    if board.pixel_mm == 0.0:
        return
    count = board.pitch_mm / board.pixel_mm
    if count < 1.0 or abs(count - round(count)) > _WHOLE_PIXELS * count:
        near = board.pixel_mm * max(1, round(count))
        raise ConfigError(
            f"A square of {board.pitch_mm:g} mm is no whole number of pixels of {board.pixel_mm:g} mm.",
            where="board.pitch_mm",
            remedy=f"Give {near:g}, as a screen draws whole pixels.",
        )


def _frequencies(given: object, count: int) -> tuple[float, ...]:
    """Read the frequencies of the dots: a list, or the first and the last one."""
    where = "board.frequencies_hz"
    _refuse(count > _MOST_DOTS, "board.columns", f"More than {_MOST_DOTS} blinking dots cannot be simulated.")
    if isinstance(given, Mapping):
        unknown = sorted(set(given) - {"first", "last"})
        _refuse(bool(unknown), f"{where}.{(unknown or [''])[0]}", "Unknown key.", "Known are: first, last.")
        first = read(Number, given.get("first", _FIRST_HZ), f"{where}.first")
        last = read(Number, given.get("last", _LAST_HZ), f"{where}.last")
        found = tuple(np.linspace(first, last, count).tolist())
    else:
        found = _one_each(given, count, where)
    bad = min(found) < 1.0 or max(found) > 1e4
    _refuse(bad, where, "A dot does not blink in this range.", "Give frequencies from 1 to 10000 Hz.")
    return found


def _one_each(given: object, count: int, where: str) -> tuple[float, ...]:
    """Read a list of one number for each dot."""
    if not isinstance(given, (list, tuple)) or len(given) != count:
        raise ConfigError(f"A list of {count} numbers is expected, one for each dot.", where=where)
    return tuple(read(Number, value, f"{where}[{index}]") for index, value in enumerate(given))


def _refuse(wrong: bool, where: str, what: str, remedy: str = "") -> None:
    """Raise an error if something is wrong."""
    if wrong:
        raise ConfigError(what, where=where, remedy=remedy)
