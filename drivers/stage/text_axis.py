"""An axis of a stage with a described text protocol: its address, scale and limits."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.stage import AxisLimits


@dataclass(frozen=True, kw_only=True)
class TextAxis:
    """One axis as the station file describes it."""

    name: str  # "pan", "tilt" or "roll"
    address: str  # The controller's word for the axis, which stands for ``{address}`` in the description
    counts_per_deg: float  # Scale; negative when the counter falls as the angle grows
    limits: AxisLimits
    zero_deg: float = 0.0  # Angle at which the counter is 0, in degrees
    tolerance_deg: float = 0.002  # Largest distance of the counter from its target at rest, in degrees
    encoder_tolerance_deg: float = 0.05  # Largest difference between encoder and counter, in degrees

    def to_counts(self, angle_deg: float) -> float:
        """Return the counter at an angle.

        angle_deg: Angle, in degrees.
        Returns: Counts, not rounded.
        """
        return (angle_deg - self.zero_deg) * self.counts_per_deg

    def to_angle_deg(self, counts: float) -> float:
        """Return the angle at a counter.

        counts: Counts.
        Returns: Angle, in degrees.
        """
        return self.zero_deg + counts / self.counts_per_deg
