"""Hands at the camera of a simulated bench: what a person turns on lens and mount."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Mapping
from typing import Any

from bench.base.errors import ControlRefused
from bench.simulated import SimulatedBench

ACTIONS: Mapping[str, tuple[str, ...]] = {
    "lens turn": ("deg",),
    "lens ring": ("deg",),
    "lens aperture": ("f_number",),
    "mount turn": ("pan_deg", "tilt_deg", "roll_deg"),
}
"""What the hands can do, with the numbers that each needs."""


class SimulatedHands:
    """Hands at the simulated camera; on a real bench, ``simulation`` is None."""

    def __init__(self, simulation: SimulatedBench | None) -> None:
        self._simulation = simulation
        self._lock = threading.Lock()
        self.seen: dict[str, Any] | None = None
        """What a person would see of lens and mount, after the last action; None before the first one."""

    @property
    def available(self) -> bool:
        """Whether the bench is a simulated one."""
        return self._simulation is not None

    def do(self, action: str, numbers: Mapping[str, float]) -> dict[str, Any]:
        """Do something with the hands; refused on a real bench, and for an unknown action."""
        if self._simulation is None:
            raise ControlRefused(
                "This bench is real: nothing can be turned from here.", remedy="Use your hands."
            )
        needed = ACTIONS.get(action)
        if needed is None or not set(numbers) <= set(needed) or not all(map(math.isfinite, numbers.values())):
            known = ", ".join(ACTIONS)
            raise ControlRefused(
                f"The hands cannot do {action!r} with {dict(numbers)}.", remedy=f"They can: {known}."
            )
        words = [action, *(f"{name}={value:g}" for name, value in numbers.items())]
        with self._lock:
            answer = self._simulation.order(" ".join(words))
            try:
                content = json.loads(answer)
            except ValueError as error:
                raise ControlRefused(
                    "The simulated bench did not answer.", remedy="Press Try again."
                ) from error
            if "error" in content:
                what = f"The simulated bench refused: {content['error']}"
                raise ControlRefused(what, remedy="Give another value.")
            self.seen = content.get("now")
        return self.seen or {}
