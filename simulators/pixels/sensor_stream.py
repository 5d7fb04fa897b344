"""What leaves the sensor from one start to one stop: the world's pose and light, as EVT3 words.

Brings the world, the scene, the pixels and the words together, 2 ms of sensor time a frame. Knows no socket.

A stream's content is a function of the seed, the resting pose, the light's and the camera's settings (where they
are simulated, of the camera's warmth and of how far the mount has crept), and of how many streams were taken at
exactly these before: the moment at which it was asked for does not enter. For the light to go on as one physical
clock all the same, the sensor starts a little after it is asked to, by up to a period of the light, when the light
has just the phase that the seed has drawn.

The sensor's clock goes on from stream to stream. A stream begins at a multiple of 102.4 ms, so that its words are the
same whenever it is taken, but for the upper part of the clock.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simulators.optics import scene
from simulators.pixels.biases import FACTORY, PixelSettings
from simulators.pixels.event_filters import FILTERS, EventFilters
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.pixels.sensor import Sensor
from simulators.world import mount, temperature
from simulators.world.world import AxisName, LightState, World

FRAME_US: Final = 2000
"""Sensor time of a frame."""
START_US: Final = 102_400
"""A stream begins at a multiple of this: of the 4096 us that TIME_LOW counts, and of the counters' 200 us."""
MOVING_SUBSAMPLES: Final = 2
"""A moving picture is blurred by its motion: coarser cells do."""


@dataclass(frozen=True)
class CameraState:
    """What is set at the camera when a stream starts."""

    biases: Mapping[str, int] = field(default_factory=lambda: dict(FACTORY))
    filters: Mapping[str, bool] = field(default_factory=lambda: dict.fromkeys(FILTERS, False))
    trigger_in: bool = False


class SensorStream:
    """A stream that is being taken.

    Parameters
    ----------
    world
        Where the axes point and what the light does.
    camera
        The camera's settings; they hold for the whole stream.
    repeats
        How many streams were taken at this very pose and these settings before, by ``stream_key``; this one
        is counted.
    clock_us
        Where the sensor's clock stands, us, not wrapped.
    """

    def __init__(self, world: World, camera: CameraState, repeats: dict[str, int], clock_us: int = 0) -> None:
        self._world = world
        self._camera = camera
        asked_s = world.now_s()
        self._light = world.light(asked_s)
        key = stream_key(world, camera, asked_s)
        repeat = repeats.get(key, 0)
        repeats[key] = repeat + 1
        seeds = _seed(world.seed, key, repeat)
        rng = np.random.default_rng(seeds)
        phase = float(rng.random())
        self._shaking = float(rng.random()), float(rng.random())
        self.start_s = asked_s + ((phase - self._light.phase_at(asked_s)) % 1.0) / self._light.frequency_hz
        self._period_starts_us = -phase * self._light.period_us
        self._begins_us = -(-clock_us // START_US) * START_US
        self._now_us = 0  # since then
        self._truth = truth = world.truth_at(asked_s)
        self._crept = mount.crept_arcsec(truth.mount, world.on_s(asked_s))
        self._angles = self._angles_now()
        width, height = truth.camera.width, truth.camera.height
        self._sensor = Sensor(
            width,
            height,
            noise=truth.noise,
            settings=PixelSettings.from_biases(camera.biases),
            camera_seed=world.camera_seed,
            seed=seeds.spawn(1)[0],
        )
        self._filters = EventFilters(width, height, camera.filters)
        self._writer = Evt3Writer(self._begins_us, width=width, height=height)
        self._sensor.begin(self._picture(moving=False), self._light, phase)

    @property
    def clock_us(self) -> int:
        """Sensor time, not wrapped, up to which the stream has been made."""
        return self._begins_us + self._now_us

    @property
    def covered_s(self) -> float:
        """World time up to which the stream has been made."""
        return self.start_s + self._now_us * 1e-6

    def next_frame(self) -> bytes:
        """Words of the next 2 ms of sensor time."""
        end_us = self._now_us + FRAME_US
        self._follow_world()
        events, entered_t = self._filters.apply(self._sensor.run(end_us))
        edge_t, edge_value = self._edges(self._now_us, end_us)
        self._now_us = end_us
        at = self._begins_us
        words = self._writer.write(
            events.t + at, events.x, events.y, events.p, until_us=self.clock_us, trigger_t=edge_t + at,
            trigger_value=edge_value, entered_t=entered_t + at,
        )  # fmt: skip
        return words.astype("<u2", copy=False).tobytes()

    def _follow_world(self) -> None:
        """Show the sensor what has changed in the world since the last frame: pose or light."""
        now_s = self.covered_s
        angles = self._angles_now()
        light = self._world.light(now_s)
        if angles == self._angles and light == self._light:
            return
        picture = None
        if angles != self._angles:
            self._angles = angles
            picture = self._picture(moving=True)
        if light != self._light:
            self._light = light
            self._period_starts_us = self._now_us - light.phase_at(now_s) * light.period_us
        phase = (self._now_us - self._period_starts_us) / light.period_us % 1.0
        self._sensor.change(picture, light, phase, FRAME_US)

    def _angles_now(self) -> Mapping[AxisName, float]:
        """Angles at which the camera stands, its mount's own motion included."""
        angles = self._world.angles_deg(self.covered_s)
        if not mount.moves(self._truth.mount):
            return angles
        return mount.disturbed(angles, self._truth.mount, self._crept, self._shaking, self._now_us * 1e-6)

    def _picture(self, *, moving: bool) -> NDArray[np.float32]:
        """What the camera sees in the present pose."""
        return scene.picture(self._truth, self._angles, subsamples=MOVING_SUBSAMPLES if moving else 4)

    def _edges(self, first_us: int, end_us: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Times and values of the light's sync edges that reach the trigger input."""
        if not (self._light.sync and self._camera.trigger_in):
            return np.empty(0, np.int64), np.empty(0, np.uint8)
        return sync_edges(self._light, self._period_starts_us, first_us, end_us)


def sync_edges(
    light: LightState, period_starts_us: float, first_us: int, end_us: int
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Edges of the light's sync line with first_us <= t < end_us: t int64 (us, rounded down), value uint8."""
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
    """What a stream's content is keyed to, as text: resting pose, light, camera settings; warmth and creep, if any."""
    key: dict[str, Any] = {
        "microsteps": dict(world.resting_microsteps(at_s)),
        "settled": world.is_settled(at_s),
        "light": world.light(at_s).settings(),
        "biases": dict(camera.biases),
        "filters": dict(camera.filters),
        "trigger_in": camera.trigger_in,
    }
    if temperature.matters(world.truth.thermal):
        key["temperature_c"] = world.temperature_c(at_s)
    if mount.moves(world.truth.mount):
        key["crept"] = mount.crept_arcsec(world.truth.mount, world.on_s(at_s))
    return json.dumps(key, sort_keys=True)


def _seed(seed: int, key: str, repeat: int) -> np.random.SeedSequence:
    """Seeds of a stream: the world's seed, a digest of the key, and the count."""
    digest = hashlib.sha256(key.encode()).digest()
    return np.random.SeedSequence([seed, repeat, *np.frombuffer(digest[:16], "<u4").tolist()])
