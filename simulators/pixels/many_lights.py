"""A sensor in front of many lights: blinking dots with a frequency each, or a screen that is drawn line by line.

The pixels know one light (`drive`), so each light has a sensor of its own, which covers the window of its image, with
the fixed pattern of the camera's pixels there. Another one covers the whole image, sees no light, and has the
background noise of all pixels. Their events are merged by time. The arbiter of the readout is not shared between them:
the lights change at different moments, so its queues seldom meet. Where the light of two dots overlaps, a pixel sees
the nearer one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulators.optics.board_scene import ImageOfLight, has_many_lights, images_of_lights
from simulators.pixels import sensor_state
from simulators.pixels.biases import PixelSettings
from simulators.pixels.sensor import Events, Sensor
from simulators.world.truth import NOISE_LEVELS, NoiseTruth, Truth
from simulators.world.world import FULL_DRIVE_V, LightState

_STEADY = LightState(output=True, low_v=FULL_DRIVE_V, high_v=FULL_DRIVE_V)
_LONGEST_S = 100.0


class Window(Sensor):
    """A sensor of some of a camera's pixels."""

    @property
    def gains(self) -> NDArray[np.uint32]:
        """(height, width) uint32, thresholds of the pixels as stored; a view."""
        return self._pixels.gains[:, : self.width, sensor_state.GAINS]

    def take_gains(self, gains: NDArray[np.uint32]) -> None:
        """Take the thresholds of other pixels.

        gains: (height, width) uint32, as stored.
        """
        self._pixels.gains[:, : self.width, sensor_state.GAINS] = gains


class Part(NamedTuple):
    """One light, and the sensor that sees it."""

    light: ImageOfLight
    sensor: Window


class ManyLightsSensor:
    """A sensor in front of many lights, in place of `Sensor`.

    parts: The lights in view and their sensors, from `begin` on.
    """

    def __init__(
        self,
        truth: Truth,
        angles_deg: Mapping[Any, float],
        *,
        settings: PixelSettings,
        camera_seed: int,
        seed: np.random.SeedSequence,
    ) -> None:
        self._noise = truth.noise
        self._settings, self._camera_seed, self._seed = settings, camera_seed, seed
        self.width, self.height = truth.camera.width, truth.camera.height
        self._clock_s = float(np.random.default_rng(seed.spawn(1)[0]).uniform(0.0, _LONGEST_S))
        self._now_us = 0.0
        self._whole = self._sensor(self.width, self.height, truth.noise)
        self.parts: list[Part] = []
        self._truth, self._angles = truth, dict(angles_deg)

    def _sensor(self, width: int, height: int, noise: NoiseTruth) -> Window:
        """Return a sensor with a seed of its own."""
        seed = self._seed.spawn(1)[0]
        return Window(
            width, height, noise=noise, settings=self._settings, camera_seed=self._camera_seed, seed=seed
        )

    def begin(
        self, picture: NDArray[np.float32], light: LightState, phase: float, *, at_us: float = 0.0
    ) -> None:
        """Start under a picture and a light; see `Sensor.begin`.

        light: Light of the board as a whole; it drives the lines of a screen. Dots have lights of their own.
        phase: Its phase at ``at_us``, in periods.
        """
        self._now_us = at_us
        self._whole.begin(np.zeros_like(picture), _STEADY, 0.0, at_us=at_us)
        self._find_lights()
        self._for_each(picture, light, phase, lambda sensor, *seen: sensor.begin(*seen, at_us=at_us))

    def change(
        self, picture: NDArray[np.float32] | None, light: LightState, phase: float, step_us: float
    ) -> None:
        """Apply a new picture or light now; see `Sensor.change`."""
        self._for_each(picture, light, phase, lambda sensor, *seen: sensor.change(*seen, step_us))

    def look_again(self, truth: Truth, angles_deg: Mapping[Any, float]) -> None:
        """Look for the lights at other places, before the next `begin`."""
        self._truth, self._angles = truth, dict(angles_deg)

    def run(self, until_us: float) -> Events:
        """Return the events up to a time; see `Sensor.run`.

        Returns: In order of time.
        """
        found = [self._whole.run(until_us)]
        for light, sensor in self.parts:
            events = sensor.run(until_us)
            x, y = events.x + np.uint16(light.left), events.y + np.uint16(light.top)
            found.append(Events(events.t, x, y, events.p))
        self._now_us = until_us
        t, x, y, p = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.argsort(t, kind="stable")
        return Events(t[order], x[order], y[order], p[order])

    def _find_lights(self) -> None:
        """Make a sensor for the window of each light, with the fixed pattern of its pixels."""
        quiet = replace(NOISE_LEVELS["none"], reset_noise=self._noise.reset_noise)
        gains = self._whole.gains
        self.parts = []
        for light in images_of_lights(self._truth, self._angles):
            height, width = light.share.shape
            sensor = self._sensor(width, height, quiet)
            sensor.take_gains(gains[light.top : light.top + height, light.left : light.left + width])
            self.parts.append(Part(light, sensor))

    def _for_each(
        self,
        picture: NDArray[np.float32] | None,
        light: LightState,
        phase: float,
        act: Callable[..., None],
    ) -> None:
        """Show each part its window of a picture, under its light and phase."""
        for seen, sensor in self.parts:
            part = None
            if picture is not None:
                rows = slice(seen.top, seen.top + sensor.height)
                part = picture[rows, seen.left : seen.left + sensor.width] * seen.share
            own, own_phase = self._light(seen, light, phase)
            act(sensor, part, own, own_phase)

    def _light(self, seen: ImageOfLight, light: LightState, phase: float) -> tuple[LightState, float]:
        """Return the light that shines on a part of the image, and its present phase, 0 to 1."""
        if seen.frequency_hz == 0.0:
            return light, (phase - seen.phase) % 1.0
        own = LightState(output=True, high_v=FULL_DRIVE_V, frequency_hz=seen.frequency_hz)
        if not seen.flickers:
            own = replace(own, low_v=own.high_v)
        return own, (seen.frequency_hz * (self._clock_s + self._now_us * 1e-6) + seen.phase) % 1.0


def make_sensor(
    truth: Truth,
    angles_deg: Mapping[Any, float],
    *,
    settings: PixelSettings,
    camera_seed: int,
    seed: np.random.SeedSequence,
) -> Sensor | ManyLightsSensor:
    """Return the sensor that a scene needs."""
    if has_many_lights(truth):
        return ManyLightsSensor(truth, angles_deg, settings=settings, camera_seed=camera_seed, seed=seed)
    width, height = truth.camera.width, truth.camera.height
    return Sensor(width, height, noise=truth.noise, settings=settings, camera_seed=camera_seed, seed=seed)
