"""One stream of the sensor, from a start to a stop: the world's pose and light, as EVT3 words.

This module connects the world, the scene, the pixels and the words, in frames of 2 ms of sensor time. It uses no
socket.

The content of a stream is a function of the seed, the resting pose, the settings of light and camera, and the number of
earlier streams with exactly these; where they are simulated, also of the camera's temperature, and of the mount's drift
and shift. It does not depend on the moment of the request. For this, the sensor starts up to one period of the light
after the request, when the light has the phase that was drawn from the seed; the light thus remains one physical clock.

The sensor's clock continues from stream to stream. A stream begins at a multiple of 102.4 ms, so that its words are the
same at any time, except for the upper part of the clock.

A preview is a stream for a live picture, at a third of the computing time. It goes on with the sensor of the preview
before it (`SensorStream.go_on`), so that its pixels need no time to settle, and while the camera turns, its picture is
coarse and changes every 8 ms. Its content also depends on earlier previews. Recordings do not depend on previews.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulators.optics import scene
from simulators.pixels.biases import FACTORY, FILTERS, PixelSettings
from simulators.pixels.evt3_writer import Evt3Writer, RateController
from simulators.pixels.sensor import Events, Sensor
from simulators.world import drift
from simulators.world.world import AxisName, LightState, World, setup_of, with_setup

FRAME_US: Final = 2000
"""Sensor time of a frame, us."""
START_US: Final = 102_400
"""A stream begins at a multiple of this, which is one of TIME_LOW's 4096 us and of the counters' 200 us."""
MOVING_SUBSAMPLES: Final = 2
"""Cells per pixel side of a moving picture; its motion blurs it, so coarser cells suffice."""
PREVIEW_SUBSAMPLES: Final = 1
PREVIEW_FRAMES: Final = 4
"""The same of a preview, which is to be quick, and the number of frames for which such a picture stays."""
SILENT_FRAMES: Final = 2
"""Frames after a change of the view that a preview does not show: pixels fire once where the brightness has changed."""
VIEW_LASTS_S: Final = 5.0
"""Time after which a preview follows the temperature of the lens, s: a lens warms up in minutes."""


@dataclass(frozen=True)
class CameraState:
    """Settings of the camera when a stream starts."""

    biases: Mapping[str, int] = field(default_factory=lambda: dict(FACTORY))
    # Whether each on-chip filter is on, by name.
    filters: Mapping[str, bool] = field(default_factory=lambda: dict.fromkeys(FILTERS, False))
    trigger_in: bool = False  # Whether the trigger input is enabled


class SensorStream:
    """A stream in progress; ``preview`` for a live picture.

    ``repeats`` counts earlier streams with the same pose and settings, by ``stream_key``; this stream is added to it.
    ``clock_us`` is the sensor's clock, not wrapped.
    """

    def __init__(
        self,
        world: World,
        camera: CameraState,
        repeats: dict[str, int],
        clock_us: int = 0,
        *,
        preview: bool = False,
    ) -> None:
        self._preview = preview
        self._frames = 0
        self._moved = False
        self._view_s = world.now_s()
        self._world = world
        self._camera = camera
        asked_s = world.now_s()
        self._light = world.light(asked_s)
        key = stream_key(world, camera, asked_s)
        seeds = world.recording_seed(key, repeats)
        rng = np.random.default_rng(seeds)
        phase = float(rng.random())
        self._vibration_phases = float(rng.random()), float(rng.random())
        self.start_s = asked_s + ((phase - self._light.phase_at(asked_s)) % 1.0) / self._light.frequency_hz
        self._period_starts_us = -phase * self._light.period_us
        self._begins_us = -(-clock_us // START_US) * START_US
        self._now_us = 0  # since _begins_us
        self._truth = truth = world.truth_at(asked_s)
        self._start_drift_arcsec = drift.drift_since_on_arcsec(truth.mount, world.on_s(asked_s))
        self._angles = self._angles_now()
        width, height = truth.camera.width, truth.camera.height
        self._sensor = Sensor(
            width,
            height,
            noise=truth.noise,
            settings=PixelSettings.from_biases(camera.biases, truth.optics.room),
            camera_seed=world.camera_seed,
            seed=seeds.spawn(1)[0],
        )
        self._controller = RateController() if camera.filters.get("erc", False) else None
        self._writer = Evt3Writer(self._begins_us, width=width, height=height)
        self._sensor.begin(self._picture(moving=False), self._light, phase)

    def go_on(self, camera: CameraState, clock_us: int) -> bool:
        """Begin the next preview with the sensor at its clock, unwrapped; False if light, settings or clock changed."""
        asked_s = self._world.now_s()
        if camera != self._camera or self._world.light(asked_s) != self._light or clock_us > self.clock_us:
            return False
        self._look_again(asked_s)
        phase = (self._now_us - self._period_starts_us) / self._light.period_us
        wait = ((phase - self._light.phase_at(asked_s)) % 1.0) / self._light.frequency_hz
        self.start_s = asked_s + wait - self._now_us * 1e-6
        self._writer = Evt3Writer(self.clock_us, width=self._writer.width, height=self._writer.height)
        return True

    def _look_again(self, now_s: float) -> None:
        """Show the sensor of a preview the present view, if it is another one than at the end of the last preview."""
        self.start_s = now_s - self._now_us * 1e-6
        angles, moving = self._angles_now(), not self._world.is_settled(now_s)
        truth = with_setup(self._truth, self._world.camera_setup(now_s))
        if now_s - self._view_s > VIEW_LASTS_S:
            truth, self._view_s = self._world.truth_at(now_s), now_s
        if angles == self._angles and truth == self._truth and moving == self._moved:
            return
        self._angles, self._truth, self._moved = angles, truth, moving
        phase = (self._now_us - self._period_starts_us) / self._light.period_us % 1.0
        self._sensor.change(self._picture(moving=moving), self._light, phase, FRAME_US)
        self._now_us += SILENT_FRAMES * FRAME_US
        self._sensor.run(self._now_us)

    @property
    def clock_us(self) -> int:
        """Sensor time, not wrapped, up to which the stream has been computed."""
        return self._begins_us + self._now_us

    @property
    def covered_s(self) -> float:
        """World time up to which the stream has been computed."""
        return self.start_s + self._now_us * 1e-6

    def next_frame(self) -> bytes:
        """Compute the next 2 ms of sensor time, as EVT3 words, little-endian."""
        end_us = self._now_us + FRAME_US
        self._follow_world()
        events = self._sensor.run(end_us)
        entered_t = events.t
        if self._controller is not None:
            keep = self._controller.passed(events.t)
            events = Events(events.t[keep], events.x[keep], events.y[keep], events.p[keep])
        edge_t, edge_value = self._edges(self._now_us, end_us)
        self._now_us = end_us
        at = self._begins_us
        same = entered_t is events.t
        t = np.add(events.t, at, out=events.t)  # in place: the events are used nowhere else
        words = self._writer.write(
            t, events.x, events.y, events.p, until_us=self.clock_us, trigger_t=edge_t + at,
            trigger_value=edge_value, entered_t=t if same else entered_t + at,
        )  # fmt: skip
        return words.astype("<u2", copy=False).tobytes()

    def _follow_world(self) -> None:
        """Apply changes of pose or light since the last frame to the sensor."""
        now_s = self.covered_s
        self._frames += 1
        if self._preview and self._frames % PREVIEW_FRAMES:
            return
        angles = self._angles_now()
        light = self._world.light(now_s)
        truth = with_setup(self._truth, self._world.camera_setup(now_s))
        moved = angles != self._angles or truth is not self._truth
        if not moved and light == self._light:
            return
        picture = None
        if moved:
            self._angles, self._truth, self._moved = angles, truth, True
            picture = self._picture(moving=True)
        if light != self._light:
            self._light = light
            self._period_starts_us = self._now_us - light.phase_at(now_s) * light.period_us
        phase = (self._now_us - self._period_starts_us) / light.period_us % 1.0
        self._sensor.change(picture, light, phase, FRAME_US)

    def _angles_now(self) -> Mapping[AxisName, float]:
        """Return the angles at which the camera points, with the mount's own motion."""
        angles = self._world.angles_deg(self.covered_s)
        if not drift.has_motion(self._truth.mount):
            return angles
        return drift.moved_angles_deg(
            angles, self._truth.mount, self._start_drift_arcsec, self._vibration_phases, self._now_us * 1e-6
        )

    def _picture(self, *, moving: bool) -> NDArray[np.float32]:
        """Return the picture in the present pose."""
        if moving:
            subsamples = PREVIEW_SUBSAMPLES if self._preview else MOVING_SUBSAMPLES
            return scene.picture(self._truth, self._angles, subsamples=subsamples)
        return scene.still_picture(self._truth, self._angles)

    def _edges(self, first_us: int, end_us: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Return times and values of the light's sync edges that reach the trigger input."""
        if not (self._light.sync and self._camera.trigger_in):
            return np.empty(0, np.int64), np.empty(0, np.uint8)
        return sync_edges(self._light, self._period_starts_us, first_us, end_us)


def sync_edges(
    light: LightState, period_starts_us: float, first_us: int, end_us: int
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return edges of the light's sync line, first_us <= t < end_us: times, us, rounded down, and levels after them."""
    period = light.period_us
    k = np.arange(
        math.floor((first_us - period_starts_us) / period) - 1, (end_us - period_starts_us) / period + 1
    )
    rising = np.floor(period_starts_us + k * period).astype(np.int64)
    falling = np.floor(period_starts_us + (k + light.high_share) * period).astype(np.int64)
    t, value = light.sync_line.carry(k.astype(np.int64), rising, falling, period)
    inside = (t >= first_us) & (t < end_us)
    return t[inside], value[inside]


def stream_key(world: World, camera: CameraState, at_s: float) -> str:
    """Return the text from which a stream's content is seeded.

    It holds resting pose, light and camera settings; also temperature, drift and shift of the mount, if they are
    simulated, and what a person has changed at the camera since the start.
    """
    key = world.situation(at_s)
    key |= {"biases": dict(camera.biases), "filters": dict(camera.filters), "trigger_in": camera.trigger_in}
    if world.truth.thermal.focal_ppm_per_c != 0.0:
        key["temperature_c"] = world.temperature_c(at_s)
    if drift.has_motion(world.truth.mount):
        key["crept"] = drift.drift_since_on_arcsec(world.truth.mount, world.on_s(at_s))
    setup, start = world.camera_setup(at_s), setup_of(world.truth)
    if setup.shift_mm != (0.0, 0.0):
        key["shift_mm"] = setup.shift_mm
    if setup.turn_deg != start.turn_deg:
        key["turn_deg"] = setup.turn_deg
    if setup.lens != start.lens:
        key["lens"] = setup.lens.focus_distance_m, setup.lens.f_number
    return json.dumps(key, sort_keys=True)
