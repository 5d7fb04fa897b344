"""State of the light: its waveform, levels and phase, and whether sync edges reach the camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from simulators.world.sync_line import SyncLine

Waveform = Literal["square", "sine"]

FULL_DRIVE_V = 5.0
"""Drive voltage at which the light has its nominal brightness; brightness is proportional to the voltage."""


@dataclass(frozen=True)
class LightState:
    """Output of the light's driver from some moment on."""

    waveform: Waveform = "square"  # "square" or "sine"
    frequency_hz: float = 60.0
    duty_percent: float = 50.0  # Length of a square's high part, as a percentage of the period
    low_v: float = 0.0
    high_v: float = 5.0
    output: bool = False  # Whether the light is driven at all; if not, it is dark
    # Whether sync edges reach the camera's trigger input (rising at the start of a period, falling at the end
    # of a square's high part or at half of a sine's period).
    sync: bool = False
    # World time at which a period begins. A period begins with the rising sync edge: the start of a square's
    # high part, or the upward crossing of a sine's middle.
    origin_s: float = 0.0
    sync_line: SyncLine = field(default_factory=SyncLine)

    @property
    def low(self) -> float:
        """Lower brightness, nominal brightness = 1 (zero if the output is off)."""
        return max(0.0, self.low_v) / FULL_DRIVE_V if self.output else 0.0

    @property
    def high(self) -> float:
        """Upper brightness, nominal brightness = 1 (zero if the output is off)."""
        return max(0.0, self.high_v) / FULL_DRIVE_V if self.output else 0.0

    @property
    def period_us(self) -> float:
        """Length of a period, us."""
        return 1e6 / self.frequency_hz

    @property
    def high_share(self) -> float:
        """Share of a period during which the sync line (and a square) is high."""
        return self.duty_percent / 100.0 if self.waveform == "square" else 0.5

    def phase_at(self, t_s: float) -> float:
        """Return the light's phase at a time.

        Returns: Phase in periods, 0 <= phase < 1.
        """
        phase = ((t_s - self.origin_s) * self.frequency_hz) % 1.0
        return phase if phase < 1.0 else 0.0  # just below a whole period, the remainder rounds up to 1

    def settings(self) -> tuple[object, ...]:
        """Return everything but the origin and the cable, from which a recording's noise is seeded."""
        return (
            self.waveform,
            self.frequency_hz,
            self.duty_percent,
            self.low,
            self.high,
            self.output,
            self.sync,
        )
