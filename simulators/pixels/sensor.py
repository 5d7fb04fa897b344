"""The event sensor: a picture and a flickering light in, contrast events out.

This module draws the fixed pattern of a camera's pixels (thresholds, dead pixels, rates of background and hot-pixel
events) and holds the state that is kept from slice to slice. ``readout`` holds the loop, and ``photoreceptor`` the
pixel's response. Optics and wire format are elsewhere.

The pixel's principle: Lichtsteiner et al. (2008). Gaussian threshold mismatch, background events and finite bandwidth:
Hu, Liu and Delbruck (2021), v2e. Arbiter and readout in an event simulator: Joubert et al. (2021). The models here are
this project's own.

The same seeds give the same events, however the time is sliced; the same camera seed gives the same pattern.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from simulators.errors import SimulationMisuse
from simulators.pixels import pixel_reset, readout, sensor_state
from simulators.pixels.biases import PixelSettings
from simulators.pixels.drive import Drive, make_drive
from simulators.pixels.photoreceptor import N_BATCH
from simulators.pixels.pixel_noise import fill_alias
from simulators.pixels.sensor_state import BLOCK, GROUP, Pixels, Readout
from simulators.world.truth import NOISE_LEVELS, NoiseTruth
from simulators.world.world import LightState

GAIN_ONE: Final = 1 << sensor_state.ON_BITS
"""Stored gain of a threshold of zero."""
RATE_SPREAD: Final = 0.4
"""Standard deviation of the logarithm of a pixel's background rate; own choice."""
THINNEST_THRESHOLD: Final = 0.2
"""Smallest threshold that the mismatch gives, as a share of the nominal one; at zero, a pixel would fire without
end."""
EPOCH_US: Final = 16384.0
"""The epoch of the pixels' times is a multiple of this; float32 then resolves 4 ns."""
FIRST_ROOM: Final = 1 << 16
"""Initial size of a slice's arrays; must exceed the longest row."""

PEAK_EVENTS_US: Final = 1066.0
"""Largest rate of the readout, events per us (1.066 GEPS; Finateu et al. 2020)."""
ROW_US: Final = 0.1  # Chosen: the maker states none; 720 rows then take 72 us
LINK_WORDS_US: Final = 100.0 - 1.0 / 16.0 - 8.0 / 200.0
"""1.6 Gbit/s of 16-bit words, without those that carry time and counters; words per us."""
FIFO_WORDS: Final = 65536.0  # That can wait for the link; the maker does not state how many


def make_pixels(
    width: int, height: int, noise: NoiseTruth, settings: PixelSettings, camera_seed: int
) -> Pixels:
    """Return a camera's pixels, without light or requests; padding pixels, up to whole blocks, never request."""
    blocks = -(-width // BLOCK)
    shape = (height, blocks * BLOCK)
    cell = np.zeros((*shape, sensor_state.N_CELL), np.float32)
    cell[:, :, sensor_state.U_REF] = 1.0
    gains = cell.view(np.uint32)
    gains[:, :width, sensor_state.GAINS] = _draw_gains(width, height, noise, settings, camera_seed)
    groups = -(-height // GROUP)
    return Pixels(
        t_next=np.full(shape, np.inf, np.float32),
        is_on=np.zeros(shape, np.uint8),
        cell=cell,
        gains=gains,
        block_min=np.full((height, blocks), np.inf, np.float32),
        row_min=np.full(groups * GROUP, np.inf, np.float32),
        group_min=np.full(groups, np.inf, np.float32),
        batch=np.zeros((N_BATCH, shape[1]), np.float32),
        column=np.zeros(shape[1] + BLOCK, np.uint32),
        off_column=np.zeros(shape[1] + BLOCK, np.uint16),
        asked=np.zeros(blocks, np.uint32),
        noise_t=np.zeros(sensor_state.AHEAD),
        noise_at=np.zeros(sensor_state.AHEAD, np.int64),
    )


@lru_cache(maxsize=2)
def _draw_gains(
    width: int, height: int, noise: NoiseTruth, settings: PixelSettings, camera_seed: int
) -> NDArray[np.uint32]:
    """Return the gains of both thresholds, (height, width); they are kept, as each recording of a camera needs them."""
    pattern = np.random.default_rng([camera_seed, 1])

    def share(threshold: float) -> NDArray[np.uint32]:
        spread = 1.0 + noise.mismatch * pattern.standard_normal((height, width), np.float32)
        gain = np.exp(-threshold * np.maximum(spread, THINNEST_THRESHOLD))
        return np.clip(np.rint(gain * GAIN_ONE), 1, GAIN_ONE - 1).astype(np.uint32)

    gains = share(settings.threshold_on)
    gains |= share(settings.threshold_off) << np.uint32(sensor_state.ON_BITS)
    gains[dead_pixels(width, height, noise, camera_seed)] = 0  # beyond any threshold
    return gains


def dead_pixels(width: int, height: int, noise: NoiseTruth, camera_seed: int) -> NDArray[np.bool_]:
    """Return which pixels of a camera are dead."""
    dead = np.zeros(width * height, np.bool_)
    dead[: round(noise.dead_share * dead.size)] = True
    if dead[0]:
        np.random.default_rng([camera_seed, 3]).shuffle(dead)
    return dead.reshape(height, width)


def draw_noise_rates(
    width: int, height: int, noise: NoiseTruth, settings: PixelSettings, camera_seed: int
) -> NDArray[np.float32]:
    """Return the rates of background and hot-pixel events of a camera's pixels."""
    pattern = np.random.default_rng([camera_seed, 2])
    n = width * height
    spread = np.exp(RATE_SPREAD * pattern.standard_normal(n, np.float32) - 0.5 * RATE_SPREAD**2)
    rates: NDArray[np.float32] = noise.background_hz * settings.background_gain * spread
    hot = pattern.choice(n, round(noise.hot_share * n), replace=False)
    rates[hot] = noise.hot_hz
    rates[dead_pixels(width, height, noise, camera_seed).ravel()] = 0.0
    return rates


class Events(NamedTuple):
    """Contrast events, in the order in which they are read."""

    t: NDArray[np.int64]  # (N,) int64, time on the sensor's clock, us
    x: NDArray[np.uint16]  # (N,) uint16, column
    y: NDArray[np.uint16]  # (N,) uint16, row
    p: NDArray[np.uint8]  # (N,) uint8, polarity, 1 = ON


def _joined(parts: list[Events]) -> Events:
    columns: list[Any] = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Events(*columns) if columns else _empty_events(0)


def _empty_events(n: int) -> Events:
    return Events(
        np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint8)
    )


@dataclass(frozen=True)
class Link:
    """Speed of the readout and of the link."""

    row_us: float = ROW_US
    event_us: float = 1.0 / PEAK_EVENTS_US
    words_us: float = LINK_WORDS_US  # 16-bit words that the link carries per us
    fifo_words: float = FIFO_WORDS

    @classmethod
    def ideal(cls) -> Link:
        """Return a link without any delay: it gives what the pixels alone would give."""
        return cls(row_us=0.0, event_us=0.0, words_us=1e12, fifo_words=1e15)


class Sensor:
    """An event sensor under a flickering light."""

    def __init__(
        self,
        width: int = 1280,
        height: int = 720,
        *,
        noise: NoiseTruth = NOISE_LEVELS["typical"],
        settings: PixelSettings | None = None,
        camera_seed: int = 0,
        seed: int | np.random.SeedSequence = 0,
        link: Link | None = None,
    ) -> None:
        self.width, self.height = width, height
        self.settings = settings if settings is not None else PixelSettings()
        self._noise = noise
        self._pixels = make_pixels(width, height, noise, self.settings, camera_seed)
        self._readout = _make_readout(width, height, noise, self.settings, camera_seed, link or Link())
        self._state = np.zeros(sensor_state.N_STATE)
        self._random = np.random.default_rng(seed).integers(1, 2**63, 2, dtype=np.uint64)
        self._drive: Drive | None = None
        self._picture = np.zeros((height, width), np.float32)
        self._now_us = 0.0
        self._rate_us = 0.0

    @property
    def gains(self) -> NDArray[np.uint32]:
        """(height, width) uint32, thresholds of the pixels as stored; a view."""
        return self._pixels.gains[:, : self.width, sensor_state.GAINS]

    @property
    def thresholds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Thresholds of this camera's pixels, ON and OFF, (height, width) each, in units of log intensity."""
        on, off = self.gains & np.uint32(GAIN_ONE - 1), self.gains >> np.uint32(sensor_state.ON_BITS)
        with np.errstate(divide="ignore"):  # thresholds of a dead pixel are infinite
            return -np.log(on / GAIN_ONE), -np.log(off / GAIN_ONE)

    @property
    def stalled_us(self) -> float:
        """Time for which the readout has waited for the link."""
        return float(self._state[sensor_state.STALL])

    def begin(
        self, picture: NDArray[np.float32], light: LightState, phase: float, *, at_us: float = 0.0
    ) -> None:
        """Start under a picture and a light, whose phase at ``at_us`` is given in periods.

        The pixels run through two periods of the light before that, at most 100 ms. They then begin in the state of a
        sensor that has seen the light for long.
        """
        warmup_us = min(2.0 * light.period_us, 1e5) if light.high > light.low else 1000.0
        begin_us = at_us - warmup_us
        epoch = math.floor(begin_us / EPOCH_US) * EPOCH_US
        self._drive = make_drive(light, at_us - phase * light.period_us, self.settings)
        state = self._state
        state[:] = 0.0
        state[sensor_state.EPOCH] = epoch
        state[sensor_state.FREE] = state[sensor_state.FIFO_T] = begin_us - epoch
        state[sensor_state.NOISE] = math.inf
        if self._readout.noise_rate_us > 0.0:
            readout.draw_noise(self._pixels, self._readout, state[sensor_state.FREE], self._random)
            state[sensor_state.NOISE] = self._pixels.noise_t[0]
        self._set_picture(picture)
        pixel_reset.start_pixels(self._pixels, self._drive, self._readout, self.width, state, self._random)
        self._now_us = begin_us
        self._advance(at_us)
        state[sensor_state.STALL] = 0.0

    def change(
        self, picture: NDArray[np.float32] | None, light: LightState, phase: float, step_us: float
    ) -> None:
        """Apply a new picture or light now."""
        self._drive = make_drive(light, self._now_us - phase * light.period_us, self.settings)
        self._set_picture(picture)
        t = self._now_us - self._state[sensor_state.EPOCH]
        pixel_reset.apply_change(self._pixels, self._drive, self.width, t, step_us, self._state, self._random)

    def _set_picture(self, picture: NDArray[np.float32] | None) -> None:
        """Store the picture in the pixels; None: the present one."""
        if picture is not None:
            if picture.shape != (self.height, self.width):
                raise SimulationMisuse(
                    f"The picture has shape {picture.shape}; the sensor has {self.height} rows of {self.width} pixels."
                )
            self._picture = np.ascontiguousarray(picture, np.float32)
        pixel_reset.set_picture(self._pixels, self._drive, self._picture)

    def run(self, until_us: float) -> Events:
        """Return the events from the end of the last call to a time."""
        if self._drive is None:
            raise SimulationMisuse("The sensor has not been shown a picture yet.", remedy="Call begin first.")
        return self._advance(until_us)

    def _advance(self, until_us: float) -> Events:
        """Run the sensor up to a time of its clock."""
        begin_us = self._now_us
        parts: list[Events] = []
        while self._now_us < until_us:
            next_epoch = self._state[sensor_state.EPOCH] + EPOCH_US
            end = min(until_us, next_epoch)
            expected = int(1.1 * self._rate_us * (end - self._now_us))
            parts += self._run_epoch(end - self._state[sensor_state.EPOCH], FIRST_ROOM + expected)
            if end == next_epoch:
                sensor_state.move_epoch(self._pixels, self._state, EPOCH_US)
            self._now_us = end
        events = parts[0] if len(parts) == 1 else _joined(parts)
        if self._now_us > begin_us:
            self._rate_us = len(events.t) / (self._now_us - begin_us)
        return events

    def _run_epoch(self, until: float, room: int) -> Iterator[Events]:
        """Find the events up to a time within the epoch, in parts that fit into arrays of some size."""
        self._state[sensor_state.FULL] = 1.0
        while self._state[sensor_state.FULL]:
            out = _empty_events(room)
            n = readout.read_rows(
                self._pixels,
                self._drive,
                self._readout,
                self._state,
                self._random,
                until,
                self.width,
                tuple(out),
            )
            yield Events(out.t[:n], out.x[:n], out.y[:n], out.p[:n])


@lru_cache(maxsize=2)
def _make_readout(
    width: int, height: int, noise: NoiseTruth, settings: PixelSettings, camera_seed: int, link: Link
) -> Readout:
    """Return the readout with the noise rates of a camera's pixels; streams share it and only read it."""
    rates = draw_noise_rates(width, height, noise, settings, camera_seed)
    n = rates.size
    total = float(rates.sum(dtype=np.float64))
    alias = np.zeros(n, np.uint64)
    if total > 0.0:
        fill_alias(rates.astype(np.float64) / (total / n), alias)
    return Readout(
        settings.dead_us,
        noise.reset_noise,
        float(link.row_us),
        float(link.event_us),
        float(link.words_us),
        float(link.fifo_words),
        total * 1e-6,
        alias,
        ndtri((np.arange(4096) + 0.5) / 4096).astype(np.float32),
    )
