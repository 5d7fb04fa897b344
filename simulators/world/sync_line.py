"""The cable from the light's sync output to the camera's trigger input, and its faults.

A period has two edges: rising at its start, falling at the end of its high part. The faults are a pure function of the
period's number, so that a recording does not depend on how it is cut into frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class SyncLine:
    """A cable; by default without faults."""

    inverted: bool = False  # Whether it swaps high and low
    missing_every: int = 0  # Both edges of every n-th period are lost; 0 for never
    extra_every: int = 0  # Every n-th period has a short false pulse in its low part; 0 for never
    jitter_us: float = 0.0
    # Share of the edges that do not cross the input's threshold, because the level is too low.
    lost_share: float = 0.0
    channel: int = 0

    def carry(
        self, periods: IntArray, rising: IntArray, falling: IntArray, period_us: float
    ) -> tuple[IntArray, NDArray[np.uint8]]:
        """Carry the edges of some periods.

        periods: (N,) int64, numbers of the periods.
        rising, falling: (N,) int64, times of their edges, us.
        period_us: Length of a period.
        Returns: Times in order, us.
        Returns: Level after each edge, and twice the channel.

        Examples
        --------
        >>> k = np.arange(4)
        >>> SyncLine(missing_every=2).carry(k, 100 * k, 100 * k + 50, 100.0)[0].tolist()
        [100, 150, 300, 350]
        """
        kept = np.ones(len(periods), bool)
        if self.missing_every:
            kept = periods % self.missing_every != 0
        t = np.concatenate([rising[kept], falling[kept]])
        value = np.repeat(np.array([1, 0], np.uint8), kept.sum())
        if self.jitter_us:
            shift = np.concatenate([_noise(2 * periods[kept]), _noise(2 * periods[kept] + 1)])
            t = t + np.round(self.jitter_us * shift).astype(np.int64)
        if self.extra_every:
            begins = falling[periods % self.extra_every == 0] + round(0.1 * period_us)
            t = np.concatenate([t, begins, begins + round(0.05 * period_us)])
            value = np.concatenate([value, np.repeat(np.array([1, 0], np.uint8), len(begins))])
        if self.lost_share:
            stays = 0.5 * (_noise(t) + 1.0) >= self.lost_share
            t, value = t[stays], value[stays]
        order = np.argsort(t, kind="stable")
        return t[order], (value[order] ^ np.uint8(self.inverted)) | np.uint8(self.channel << 1)


def _noise(numbers: IntArray) -> NDArray[np.float64]:
    """Return a fixed pseudo-random value for each number, uniform in -1 to 1.

    The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
    """
    z = numbers.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (z ^ (z >> np.uint64(31))).astype(np.float64) / 2.0**63 - 1.0
