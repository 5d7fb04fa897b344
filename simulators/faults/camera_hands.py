"""Hands of a person: somebody turns the focus ring, closes the aperture, or turns the camera.

The orders come on the same line as those for faults (`catalogue`). This module changes the world's `CameraSetup`; the
camera sees the change at once, also in the middle of a recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from simulators.errors import ConfigError
from simulators.faults.catalogue import FaultOrder
from simulators.optics.lens_focus import focus_of, ring_deg, with_ring_at
from simulators.reading import Vector, read
from simulators.world.truth import FNumber, FocusDistance, Truth
from simulators.world.world import CameraSetup, World, with_setup

HAND_DEVICES: Final = ("mount", "lens")
"""Devices of the orders that `CameraHands` carries out."""


class CameraHands:
    """Hands of a person at the camera; ``changed`` is called after each change."""

    def __init__(self, world: World, changed: Callable[[], None]) -> None:
        self._world = world
        self._changed = changed

    def action(self, order: FaultOrder) -> Callable[[], None]:
        """Return the call that carries out an order for one of `HAND_DEVICES`; it changes the setup at once."""
        start = self._world.truth
        make = {"mount": _at_mount, "lens": _at_lens}[order.device]
        change = make(order, start)

        def act() -> None:
            self._world.change_setup(change)
            self._changed()

        return act

    def seen(self) -> dict[str, Any]:
        """Return what can be read from lens and mount now."""
        setup = self._world.camera_setup(self._world.now_s())
        truth = with_setup(self._world.truth, setup)
        distance_m = focus_of(truth).distance_m
        return {
            "focus_distance_m": distance_m if math.isfinite(distance_m) else "infinity",
            "ring_deg": ring_deg(truth),
            "f_number": setup.lens.f_number,
            "turn_deg": list(setup.turn_deg),
            "shift_mm": list(setup.shift_mm),
        }


def _at_mount(order: FaultOrder, start: Truth) -> Callable[[CameraSetup], CameraSetup]:
    """Return the change of an order for the mount."""
    mount = start.mount
    if order.fault == "mend":
        return lambda setup: replace(setup, shift_mm=mount.shift_mm, turn_deg=mount.turn_deg)
    values = {name: _finite(value, name) for name, value in order.parameters.items()}
    if order.fault == "shift":
        return lambda setup: replace(setup, shift_mm=(values["x_mm"], values["y_mm"]))
    by_deg = values["pan_deg"], values["tilt_deg"], values["roll_deg"]
    return lambda setup: replace(setup, turn_deg=_sum(setup.turn_deg, by_deg))


def _sum(vector: Vector, other: Vector) -> Vector:
    (a, b, c), (x, y, z) = vector, other
    return a + x, b + y, c + z


def _at_lens(order: FaultOrder, start: Truth) -> Callable[[CameraSetup], CameraSetup]:
    """Return the change of an order for the lens."""
    p = order.parameters
    if order.fault == "mend":
        return lambda setup: replace(setup, lens=start.lens)
    if order.fault == "aperture":
        number = read(FNumber, p["f_number"], "f_number")
        return lambda setup: replace(setup, lens=replace(setup.lens, f_number=number))
    if order.fault == "focus":
        distance_m = read(FocusDistance, p["distance_m"], "distance_m")
        return lambda setup: replace(setup, lens=replace(setup.lens, focus_distance_m=distance_m))
    deg = _finite(p["deg"], "deg")
    if order.fault == "turn" and deg == 0.0:
        return lambda setup: setup  # a look at the ring changes nothing, not even by a rounding

    def turn_ring(setup: CameraSetup) -> CameraSetup:
        truth = with_setup(start, setup)
        before = ring_deg(truth) if order.fault == "turn" else 0.0
        return replace(setup, lens=with_ring_at(truth, before + deg))

    return turn_ring


def _finite(value: object, where: str) -> float:
    """Check that a parameter is a finite number."""
    number = float(str(value))
    if not math.isfinite(number):
        raise ConfigError(f"A finite number is expected, not {value}.", where=where)
    return number
