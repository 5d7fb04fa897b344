"""Reader of the configuration's section ``board``: each key is checked, and an error names the key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from itertools import pairwise
from typing import Any, Final

import numpy as np

from simulators.errors import ConfigError
from simulators.world.board_truth import KINDS, SURFACES, Anywhere, BoardTruth, HandTruth, Placement

_SURFACE_OF: Final = {"checkerboard": "screen", "blinking-dots": "leds"}
_DOT_SHARES: Final = {"circles": 0.5, "asymmetric-circles": 1.0, "blinking-dots": 0.3}
_FIRST_HZ, _LAST_HZ = 200.0, 600.0
_MOST_POINTS: Final = 2000
_MOST_DOTS: Final = 255
_WHOLE_PIXELS: Final = 1e-3
_READ_ELSEWHERE: Final = ("placements", "anywhere", "hand", "frequencies_hz", "phases")
_COMPUTED: Final = ("seed", "field_tangents", "state", "shake")


def board_from_config(given: object) -> BoardTruth:
    """Read the section of the board.

    given: Mapping with the keys of `BoardTruth`, or empty. ``frequencies_hz`` is a list, or a mapping with
      ``first`` and ``last``. ``placements`` is a list of mappings; without it, places are drawn by
      ``anywhere``.
    Returns: Defaults of the kind, with the given keys replaced; without ``kind`` if nothing is given.
    Raises ConfigError: If a key is unknown or its value is not valid; the error names the key.

    Examples
    --------
    >>> board_from_config({"kind": "circles", "columns": 9, "rows": 6, "pitch_mm": 25}).dot_mm
    12.5
    """
    section = _mapping(given, "board")
    if not section:
        return BoardTruth()
    kind = _one_of(section.get("kind", ""), KINDS, "board.kind")
    surface = _one_of(section.get("surface", _SURFACE_OF.get(kind, "print")), SURFACES, "board.surface")
    known = [one.name for one in fields(BoardTruth) if one.name not in _COMPUTED]
    values: dict[str, Any] = {"kind": kind, "surface": surface}
    for key, value in section.items():
        if key not in known:
            raise ConfigError("Unknown key.", where=f"board.{key}", remedy=f"Known are: {', '.join(known)}.")
        if key not in _READ_ELSEWHERE and key not in values:
            values[key] = _plain(key, value)
    if kind != "stars":
        _check_grid(values)
    pitch_mm = values.get("pitch_mm", 0.0)
    values.setdefault("dot_mm", _DOT_SHARES.get(kind, 0.0) * pitch_mm)
    values.setdefault("margin_mm", 10.0 if kind == "stars" else pitch_mm if surface == "print" else 0.0)
    values.setdefault("black", 0.04 if surface == "print" else 0.0)
    _check_dots(kind, values)
    _check_screen(surface, values)
    count = values.get("columns", 0) * values.get("rows", 0)
    if kind == "blinking-dots":
        values["frequencies_hz"] = _frequencies(section.get("frequencies_hz", {}), count)
        values["phases"] = _phases(section.get("phases", [0.0] * count), count)
    else:
        for key in ("frequencies_hz", "phases"):
            _refuse(key in section, f"board.{key}", "Only blinking dots have one.", "Remove it.")
    return BoardTruth(
        **values,
        placements=_placements(section.get("placements", [])),
        anywhere=_anywhere(section.get("anywhere", {})),
        hand=_hand(section.get("hand", {})),
    )


def _plain(key: str, value: object) -> float | int:
    """Check one of the section's plain numbers."""
    where = f"board.{key}"
    number = _number(value, where)
    if key in ("columns", "rows", "frames_on", "frames_off"):
        whole = number == int(number) and number >= 1
        _refuse(not whole, where, f"A whole number of at least 1 is expected, not {value!r}.")
        return int(number)
    _refuse(number < 0.0, where, f"{value!r} is negative.", "Give a number of at least 0.")
    if key in ("fill", "black", "scan"):
        _refuse(number > 1.0, where, f"{value!r} is more than 1.", "Give a share from 0 to 1.")
    return number


def _check_grid(values: Mapping[str, Any]) -> None:
    """Check the number of points and their distance."""
    for key in ("columns", "rows"):
        few = values.get(key, 0) < 2
        _refuse(few, f"board.{key}", "A board needs at least 2 points along each side.", "Count the points.")
    many = values["columns"] * values["rows"] > _MOST_POINTS
    _refuse(many, "board.columns", f"A board of more than {_MOST_POINTS} points cannot be simulated.")
    missing = values.get("pitch_mm", 0.0) <= 0.0
    _refuse(missing, "board.pitch_mm", "The distance of the points is missing.", "Give it in mm.")


def _check_dots(kind: str, values: Mapping[str, Any]) -> None:
    """Check that circles do not touch each other."""
    if kind not in _DOT_SHARES:
        return
    nearest = values["pitch_mm"] * (math.sqrt(2.0) if kind == "asymmetric-circles" else 1.0)
    touch = not 0.0 < values["dot_mm"] < nearest
    _refuse(touch, "board.dot_mm", f"Circles of {values['dot_mm']:g} mm that are {nearest:g} mm apart touch.",
            "Give a smaller diameter.")  # fmt: skip


def _check_screen(surface: str, values: Mapping[str, Any]) -> None:
    """Check the keys of a screen."""
    if surface != "screen":
        for key in ("pixel_mm", "fill", "refresh_hz", "frames_on", "frames_off", "scan"):
            _refuse(key in values, f"board.{key}", f"The surface {surface!r} is no screen.", "Remove it.")
        return
    _refuse(values["kind"] != "checkerboard", "board.surface", "A screen shows a checkerboard.",
            "Use surface: print.")  # fmt: skip
    _refuse(values.get("fill", 1.0) <= 0.0, "board.fill", "A screen without light is not seen.")
    _refuse("scan" in values and not values.get("refresh_hz"), "board.scan",
            "Only a screen with a refresh rate is drawn line by line.", "Give refresh_hz.")  # fmt: skip
    pixel_mm, pitch_mm = values.get("pixel_mm", 0.0), values["pitch_mm"]
    if pixel_mm == 0.0:
        return
    count = pitch_mm / pixel_mm
    if count < 1.0 or abs(count - round(count)) > _WHOLE_PIXELS * count:
        near = pixel_mm * max(1, round(count))
        raise ConfigError(
            f"A square of {pitch_mm:g} mm is no whole number of pixels of {pixel_mm:g} mm.",
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
        first = _number(given.get("first", _FIRST_HZ), f"{where}.first")
        last = _number(given.get("last", _LAST_HZ), f"{where}.last")
        found = tuple(np.linspace(first, last, count).tolist())
    else:
        found = _numbers(given, count, where)
    bad = min(found) < 1.0 or max(found) > 1e4
    _refuse(bad, where, "A dot does not blink in this range.", "Give frequencies from 1 to 10000 Hz.")
    return found


def _phases(given: object, count: int) -> tuple[float, ...]:
    """Read the phases of the dots."""
    return _numbers(given, count, "board.phases")


def _numbers(given: object, count: int, where: str) -> tuple[float, ...]:
    """Read a list of one number for each dot."""
    _refuse(not isinstance(given, (list, tuple)) or len(given) != count, where,
            f"A list of {count} numbers is expected, one for each dot.")  # fmt: skip
    assert isinstance(given, (list, tuple))
    return tuple(_number(value, f"{where}[{index}]") for index, value in enumerate(given))


def _placements(given: object) -> tuple[Placement, ...]:
    """Read the script of placements."""
    _refuse(not isinstance(given, (list, tuple)), "board.placements", "A list of placements is expected.")
    assert isinstance(given, (list, tuple))
    return tuple(_placement(one, f"board.placements[{index}]") for index, one in enumerate(given))


def _placement(given: object, where: str) -> Placement:
    """Read one placement."""
    section = _known(_mapping(given, where), Placement, where)
    _refuse("position_mm" not in section, where, "The placement has no position_mm.", "Give three numbers.")
    values: dict[str, Any] = {
        key: _vector(value, f"{where}.{key}") for key, value in section.items() if key != "flicker"
    }
    _refuse(values["position_mm"][2] <= 0.0, f"{where}.position_mm", "The board is not in front of the camera.",
            "Give a positive third number.")  # fmt: skip
    flicker = section.get("flicker", True)
    _refuse(not isinstance(flicker, bool), f"{where}.flicker", "True or false is expected.")
    return Placement(**values, flicker=bool(flicker))


def _anywhere(given: object) -> Anywhere:
    """Read the section of random placements."""
    where = "board.anywhere"
    section = _known(_mapping(given, where), Anywhere, where)
    chosen = Anywhere(**{key: _number(value, f"{where}.{key}") for key, value in section.items()})
    _refuse(chosen.distance_mm <= 0.0, f"{where}.distance_mm", "The board is not in front of the camera.")
    share = 0.0 <= chosen.distance_spread < 1.0
    _refuse(not share, f"{where}.distance_spread", "A share below 1 is expected.")
    _refuse(not 0.0 <= chosen.tilt_deg <= 80.0, f"{where}.tilt_deg", "Give an angle from 0 to 80 degrees.")
    return chosen


def _hand(given: object) -> HandTruth:
    """Read the section of the hand."""
    where = "board.hand"
    section = _known(_mapping(given, where), HandTruth, where)
    values: dict[str, Any] = {}
    for key, value in section.items():
        if key == "shake_spectrum":
            values[key] = _spectrum(value, f"{where}.{key}")
            continue
        values[key] = _number(value, f"{where}.{key}")
        _refuse(
            values[key] < 0.0, f"{where}.{key}", f"{value!r} is negative.", "Give a number of at least 0."
        )
    return HandTruth(**values)


def _spectrum(given: object, where: str) -> tuple[tuple[float, float], ...]:
    """Read the points of a power spectrum."""
    pairs = isinstance(given, (list, tuple)) and len(given) >= 2
    _refuse(not pairs, where, "At least two points are expected.", "Give a list of [Hz, density].")
    assert isinstance(given, (list, tuple))
    points = []
    for index, one in enumerate(given):
        pair = isinstance(one, (list, tuple)) and len(one) == 2
        _refuse(not pair, f"{where}[{index}]", "A pair is expected.", "Give [Hz, density].")
        points.append((_number(one[0], f"{where}[{index}]"), _number(one[1], f"{where}[{index}]")))
    hz, density = zip(*points, strict=True)
    rising = all(a < b for a, b in pairwise(hz)) and hz[0] >= 0.0 and hz[-1] <= 500.0
    _refuse(not rising, where, "The frequencies must rise, from at least 0 to at most 500 Hz.")
    _refuse(min(density) < 0.0 or max(density) == 0.0, where, "The densities must be positive.")
    return tuple(points)


def _known(section: Mapping[str, Any], kind: type, where: str) -> Mapping[str, Any]:
    """Check that every key is a field."""
    names = [one.name for one in fields(kind)]
    for key in section:
        _refuse(key not in names, f"{where}.{key}", "Unknown key.", f"Known are: {', '.join(names)}.")
    return section


def _mapping(given: object, where: str) -> Mapping[str, Any]:
    """Check that it is a mapping."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"A mapping is expected, not {given!r}.", where=where)
    return given


def _one_of(value: object, known: tuple[str, ...], where: str) -> str:
    """Check that it is one of a few words."""
    if value not in known:
        raise ConfigError(f"Unknown value {value!r}.", where=where, remedy=f"Use one of: {', '.join(known)}.")
    return str(value)


def _vector(value: object, where: str) -> tuple[float, float, float]:
    """Check that it is three numbers."""
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise ConfigError(f"3 numbers are expected, not {value!r}.", where=where)
    x, y, z = (_number(one, where) for one in value)
    return x, y, z


def _number(value: object, where: str) -> float:
    """Check that it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ConfigError(f"A finite number is expected, not {value!r}.", where=where)
    return float(value)


def _refuse(wrong: bool, where: str, what: str, remedy: str = "") -> None:
    """Raise an error if something is wrong."""
    if wrong:
        raise ConfigError(what, where=where, remedy=remedy)
