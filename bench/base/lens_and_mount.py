"""Lens and mount of the simulated camera, as the hands of a person would set them. Imports no simulator."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass

from bench.base.errors import SimulationError


@dataclass(frozen=True)
class LensAndMount:
    """What can be read from the simulated camera's lens and mount."""

    # Distance on the scale of the focus ring; infinite for parallel light, negative beyond infinity.
    focus_distance_m: float
    # Angle of the focus ring: 0 at infinity, 180 at the near stop, negative beyond infinity.
    ring_deg: float
    f_number: float
    turn_deg: tuple[float, float, float]
    # How far the camera was moved across the beam, along the target's X and Y.
    shift_mm: tuple[float, float]


class SimulatedHands:
    """Hands of a person at the lens and the mount of the simulated camera. A real bench has none.

    Each method returns what lens and mount show afterwards. It raises `SimulationError` if the simulated bench has
    ended or refuses: for example, the focus ring does not reach that distance. The image changes at once, also during a
    recording.

    order: Sends an order to the simulated bench and returns its answer: `SimulatedBench.order`.
    """

    def __init__(self, order: Callable[[str], str]) -> None:
        self._order = order

    def look(self) -> LensAndMount:
        """Read lens and mount without a change."""
        return self._do("lens", "turn", deg=0.0)

    def turn_focus(self, by_deg: float) -> LensAndMount:
        """Turn the focus ring, at most to its stop.

        by_deg: Angle; positive: focus nearer.
        """
        return self._do("lens", "turn", deg=by_deg)

    def set_focus_ring(self, to_deg: float) -> LensAndMount:
        """Turn the focus ring to an angle, at most to its stop."""
        return self._do("lens", "ring", deg=to_deg)

    def focus_at(self, distance_m: float) -> LensAndMount:
        """Turn the focus ring until a distance is in focus.

        distance_m: The distance; ``math.inf`` for infinity.
        """
        return self._do("lens", "focus", distance_m=distance_m)

    def set_aperture(self, f_number: float) -> LensAndMount:
        """Set the aperture."""
        return self._do("lens", "aperture", f_number=f_number)

    def turn_camera(
        self, *, pan_deg: float = 0.0, tilt_deg: float = 0.0, roll_deg: float = 0.0
    ) -> LensAndMount:
        """Loosen the camera in its mount and turn it, from how it stands."""
        return self._do("mount", "turn", pan_deg=pan_deg, tilt_deg=tilt_deg, roll_deg=roll_deg)

    def shift_camera(self, x_mm: float, y_mm: float) -> LensAndMount:
        """Move the camera across the beam, to a distance from where it was aligned.

        x_mm, y_mm: Distance along the target's X and Y.
        """
        return self._do("mount", "shift", x_mm=x_mm, y_mm=y_mm)

    def place_board(self, number: int) -> LensAndMount:
        """Put the board of the simulated bench at a placement of its script.

        number: Number of the placement, from 1; the same number always gives the same place.
        """
        return self._do("board", "place", number=number)

    def put_back(self) -> LensAndMount:
        """Put lens and mount back to how they stood when the simulated bench started."""
        self._do("mount", "mend")
        return self._do("lens", "mend")

    def _do(self, device: str, what: str, **parameters: float) -> LensAndMount:
        """Send an order, and read the answer."""
        text = self._order(json.dumps({"device": device, "fault": what, **parameters}))
        try:
            answer = json.loads(text)
        except json.JSONDecodeError as error:
            raise SimulationError("The simulated bench has ended by itself.") from error
        if not answer["ok"]:
            raise SimulationError(str(answer["error"]))
        now = answer["now"]
        (pan, tilt, roll), (x, y) = now["turn_deg"], now["shift_mm"]
        focus_m = float(now["focus_distance_m"])
        return LensAndMount(focus_m, now["ring_deg"], now["f_number"], (pan, tilt, roll), (x, y))
