"""Fixed pattern of a camera's pixels: thresholds, dead pixels, and rates of background and hot-pixel events.

The same camera seed gives the same pattern. Gaussian threshold mismatch as in v2e (Hu, Liu and Delbruck 2021).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulators.pixels import sensor_state
from simulators.pixels.biases import PixelSettings
from simulators.pixels.lanes import BLOCK
from simulators.pixels.photoreceptor import N_BATCH
from simulators.pixels.sensor_state import GROUP, Pixels
from simulators.world.truth import NoiseTruth

GAIN_ONE: Final = 1 << sensor_state.ON_BITS
"""Stored gain of a threshold of zero."""
RATE_SPREAD: Final = 0.4
"""Standard deviation of the logarithm of a pixel's background rate."""
THINNEST_THRESHOLD: Final = 0.2
"""Smallest threshold that the mismatch gives, as a share of the nominal one."""


def make_pixels(
    width: int, height: int, noise: NoiseTruth, settings: PixelSettings, camera_seed: int
) -> Pixels:
    """Return pixels with the thresholds of a camera; padding pixels, up to whole blocks, never request.

    Returns: Without light and without requests.
    """
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
    """Return which pixels of a camera are dead.

    Returns: True for a dead pixel.
    """
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
