"""The lamp between its driver and the bench, with faults that the driver does not notice.

The driver (a generator or a strobe controller) sets the light that it believes to produce. The lamp
applies its faults and publishes the light that results. Both are a `LightState`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

from simulators.world.world import LightState, SyncLine

#: Faults of the light, by name: what happens, and the usual factor, if there is one.
LAMP_FAULTS: Final[Mapping[str, tuple[str, float | None]]] = {
    "lamp_open": ("the lamp stays dark; its driver does not notice", None),
    "dim": ("the brightness is multiplied by factor", 0.5),
    "wrong_frequency": ("the flicker frequency is multiplied by factor; the driver does not notice", 0.5),
    "wrong_duty": ("the duty cycle is multiplied by factor; the driver does not notice", 0.5),
    "no_sync": ("sync edges no longer reach the camera", None),
    "sync_inverted": ("the sync line is inverted", None),
    "sync_weak": ("the level of the sync line is too low: the share factor of its edges is lost", 0.3),
    "sync_channel": ("the sync cable is plugged into the trigger channel factor", 1.0),
    "sync_missing": ("both sync edges of every factor-th period are lost", 2.0),
    "sync_extra": ("an extra sync pulse arrives in every factor-th period", 2.0),
    "sync_jitter": ("sync edges arrive up to factor (a share of the period) early or late", 0.1),
}


class Lamp:
    """A lamp and its cables."""

    def __init__(self, show: Callable[[LightState], None]) -> None:
        self._show = show
        self._driven = LightState()
        self._faults: dict[str, float] = {}
        """Factor of each injected fault, by its name."""

    def drive(self, state: LightState) -> None:
        """Set the light that the driver produces from now on."""
        self._driven = state
        faults = self._faults
        brightness, frequency = faults.get("dim", 1.0), faults.get("wrong_frequency", 1.0)
        self._show(
            replace(
                state,
                low_v=state.low_v * brightness,
                high_v=state.high_v * brightness,
                frequency_hz=state.frequency_hz * frequency,
                duty_percent=min(99.0, state.duty_percent * faults.get("wrong_duty", 1.0)),
                sync=state.sync and "no_sync" not in faults,
                sync_line=SyncLine(
                    inverted=("sync_inverted" in faults) != state.sync_line.inverted,
                    missing_every=self._count("sync_missing"),
                    extra_every=self._count("sync_extra"),
                    lost_share=min(1.0, faults.get("sync_weak", 0.0)),
                    channel=min(15, round(faults.get("sync_channel", 0.0))),
                    jitter_us=faults.get("sync_jitter", 0.0) * state.period_us / frequency,
                ),
            )
        )

    def inject_fault(self, kind: str, factor: float = 0.5) -> None:
        """Inject one of `LAMP_FAULTS` that lasts until `clear_faults`; some ignore the factor, which is positive."""
        if kind == "lamp_open":
            kind, factor = "dim", 0.0
        self._faults[kind] = factor
        self.drive(self._driven)

    def clear_faults(self) -> None:
        """Remove all faults."""
        self._faults.clear()
        self.drive(self._driven)

    def _count(self, kind: str) -> int:
        """Return every how many periods a fault comes; 0 for never."""
        return max(1, round(self._faults[kind])) if kind in self._faults else 0
