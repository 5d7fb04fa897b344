"""Biases of the IMX636: their names and ranges, and the physical pixel settings that they lead to.

Biases are offsets from the factory value. **Published** are their names, their recommended ranges and the direction of
their effect (OpenEB's ``imx636_bias_settings.h``; the manufacturer's page on biases); the camera reports its own dead
time. No public document gives the effect of an offset in percent, hertz or microseconds; the manufacturer's data sheet,
which may give it, is not public. The laws here are therefore **assumptions**. They are exponential, as a transistor's
current depends on its voltage below threshold, which controls a pixel's follower, high-pass and dead time (Graca et al.
2023). They are scaled to published extremes (contrast thresholds from 11 %, factory value 25 %; latency tenfold with
``bias_fo``).

============== =========== ======================================= ===========================
bias           range       published                               assumed, over that range
============== =========== ======================================= ===========================
bias_diff_on   -85 to 140  higher: less sensitive                  11.6 % to 105 %, factory 25 %
bias_diff_off  -35 to 190  higher: less sensitive                  18.1 % to 197 %, factory 25 %
bias_fo        -35 to 55   higher: faster, noisier                 200 us to none (1 us or less)
bias_hpf       0 to 120    higher: slow changes go, and background none at 0; 0.53 Hz to 393 Hz
bias_refr      -20 to 235  higher: shorter dead time               69.8 us to 1.0 us, factory 50 us
============== =========== ======================================= ===========================

The photoreceptor's time constant (20 us at nominal brightness) is an assumption, too, and so is the dependence of
background events on thresholds and bandwidth. The simulated effect of a bias has the right direction, but not
necessarily the right size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

ALLOWED: Final[Mapping[str, tuple[int, int]]] = {
    "bias_diff_on": (-85, 140),
    "bias_diff_off": (-35, 190),
    "bias_fo": (-35, 55),
    "bias_hpf": (0, 120),
    "bias_refr": (-20, 235),
}
"""Smallest and largest offset that the camera accepts: the recommended ranges of the real one."""

FACTORY: Final[Mapping[str, int]] = dict.fromkeys(ALLOWED, 0)

FILTERS: Final = ("afk", "stc", "trail", "erc")
"""The camera's names of its on-chip filters. Only the event rate controller, "erc", can be switched on."""

FASTEST_FOLLOWER_US: Final = 1.0
"""The follower's time constant at the factory value; it is below the sensor's resolution and ignored."""


@dataclass(frozen=True)
class PixelSettings:
    """Physical settings of all pixels, before their mismatch."""

    threshold_on: float = math.log(1.25)
    threshold_off: float = math.log(1.25)
    dead_us: float = 50.0  # Refractory time after a read
    q_us: float = 20.0  # Time constant of the photoreceptor at nominal brightness (1)
    ambient: float = 1.0 / 9.0  # Constant light (stray light, dark current), nominal brightness = 1
    background_gain: float = 1.0
    # Time constant of the source follower behind the photoreceptor, a second low-pass pole; 0: none.
    follower_us: float = 0.0
    high_pass_hz: float = 0.0  # Corner frequency of the high-pass before the comparators; 0: none

    @classmethod
    def from_biases(cls, biases: Mapping[str, int], room: float = 0.0) -> PixelSettings:
        """Return the settings for a set of biases: offsets from the factory value, by name; missing = 0.

        ``room`` is light of the room on all pixels, nominal brightness = 1.

        >>> PixelSettings.from_biases({"bias_diff_on": 140}).threshold_on > 3 * PixelSettings().threshold_on
        True
        """
        factory = cls()
        on, off = biases.get("bias_diff_on", 0), biases.get("bias_diff_off", 0)
        follower_us = FASTEST_FOLLOWER_US * math.exp(-biases.get("bias_fo", 0) / 6.6)
        high_pass = biases.get("bias_hpf", 0)
        return cls(
            threshold_on=factory.threshold_on * math.exp(on / 120.0),
            threshold_off=factory.threshold_off * math.exp(off / 120.0),
            dead_us=factory.dead_us * math.exp(-biases.get("bias_refr", 0) / 60.0),
            q_us=factory.q_us,
            ambient=factory.ambient + room,
            background_gain=factory.q_us
            / (factory.q_us + follower_us - FASTEST_FOLLOWER_US)
            * math.exp(-high_pass / 40.0 - (on + off) / 120.0),
            follower_us=follower_us if follower_us > FASTEST_FOLLOWER_US else 0.0,
            high_pass_hz=0.5 * math.exp(high_pass / 18.0) if high_pass > 0 else 0.0,
        )
