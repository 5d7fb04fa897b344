"""Event slices of a simulated camera without devices: a scene, a pose, a flickering light, and its events at once.

It serves comparisons of methods, which need thousands of recordings. Optics, pixels and readout are those of the
simulated bench; there are no drivers, files, triggers or times. The same section and seeds give the same events.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from board_scene import ShownBoard, corners
from board_scene import picture as board_picture
from numpy.typing import NDArray
from still_picture import simulate

from simulators.config import bench_config
from simulators.optics import scene
from simulators.optics.lens_focus import truth_record
from simulators.pixels.sensor import Events, Sensor
from simulators.world.gimbal import Gears
from simulators.world.truth import Truth
from simulators.world.world import FULL_DRIVE_V, LightState

QUARTER = {"width": 640, "height": 360, "fx": 1672, "fy": 1672, "cx": 320, "cy": 180}
"""A camera with a quarter of the pixels, and the field of view of the whole one."""
_STEADY_LIGHT = LightState(output=True, low_v=FULL_DRIVE_V, high_v=FULL_DRIVE_V, frequency_hz=1000.0)
_MOVING_SUBSAMPLES = 2


@dataclass(frozen=True)
class VirtualCapture:
    """Events of one recording."""

    events: Events  # Events in the order in which they are read
    image_size: tuple[int, int]  # Width and height of the sensor, px
    light_hz: float  # Frequency of the light, Hz
    first_edge_us: float  # Time of the first rising edge of the light, us
    duration_us: float  # Length of the recording, us


class VirtualCamera:
    """A simulated camera in its scene, by a ``simulation`` section; the seed is for what that does not state.

    Section ``screen``, the fields of `ShownBoard`, puts a flat board in place of the collimator.
    """

    def __init__(self, section: Mapping[str, Any], seed: int) -> None:
        own = dict(section)
        screen = own.pop("screen", None)
        self._board = None if screen is None else ShownBoard(**screen)
        self._truth: Truth = bench_config(own).truth_for(seed)
        self._seed = seed
        self._gears = Gears(self._truth.gimbal)

    def truth(self) -> dict[str, Any]:
        """Return the true parameters by part (``camera``, ``collimator`` ...), as the simulated bench writes them."""
        return truth_record(self._truth)

    def board_corners_px(self) -> NDArray[np.float64]:
        """Return the true image points of the inner corners of the board on the screen, at zero angles."""
        assert self._board is not None
        return corners(self._truth, self._board, {})

    def picture(self, angles_deg: Mapping[str, float]) -> NDArray[np.float32]:
        """Return each pixel's share of the light."""
        if self._board is not None:
            return board_picture(self._truth, self._board, angles_deg)
        return scene.picture(self._truth, angles_deg)

    def capture(
        self, angles_deg: Mapping[str, float], *, seed: int, light_hz: float = 60.0, periods: int = 2
    ) -> VirtualCapture:
        """Turn the camera and record whole periods; loads stand behind their play at readings ``angles_deg``."""
        seen = self.picture(self._gears.load_angles_deg(angles_deg))
        light = LightState(output=True, sync=True, frequency_hz=light_hz)
        phase = float(np.random.default_rng((seed, 1)).random())
        duration_us = (periods + 0.05) * light.period_us
        events = simulate(
            seen, light, duration_us, phase=phase, noise=self._truth.noise, camera_seed=self._seed, seed=seed
        )
        size = (self._truth.camera.width, self._truth.camera.height)
        return VirtualCapture(events, size, light_hz, (1.0 - phase) * light.period_us, duration_us)

    def capture_moving(
        self,
        board_at: Callable[[float], tuple[tuple[float, float, float], tuple[float, float, float]]],
        duration_us: float,
        *,
        seed: int,
        frame_us: float = 1000.0,
    ) -> VirtualCapture:
        """Record a board that moves before the camera under a steady light; a moving camera sees the same.

        The picture changes in steps of ``frame_us``. The events that a step causes are spread evenly over the time of
        the step, so it should move the picture by about one pixel. ``board_at`` returns position, mm, and turn,
        degrees, of the board at a time in us, as the section ``screen`` has them.
        """
        camera, light = self._truth.camera, _STEADY_LIGHT
        seeds = {"camera_seed": self._seed, "seed": seed}
        sensor = Sensor(camera.width, camera.height, noise=self._truth.noise, **seeds)
        sensor.begin(self._moved_picture(board_at(0.0)), light, 0.0)
        parts = []
        for step in range(1, max(1, round(duration_us / frame_us)) + 1):
            sensor.change(self._moved_picture(board_at(step * frame_us)), light, 0.0, frame_us)
            parts.append(sensor.run(step * frame_us))
        events = Events(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        return VirtualCapture(events, (camera.width, camera.height), 0.0, 0.0, duration_us)

    def _moved_picture(
        self, placed: tuple[tuple[float, float, float], tuple[float, float, float]]
    ) -> NDArray[np.float32]:
        assert self._board is not None
        board = replace(self._board, position_mm=placed[0], turn_deg=placed[1])
        return board_picture(self._truth, board, {}, subsamples=_MOVING_SUBSAMPLES)
