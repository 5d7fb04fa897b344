"""The lamp between its driver and the bench: what can go wrong with light while the driver says all is well.

Knows light states only. A driver (generator, strobe controller) tells it what it puts out; the world is told
what comes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from simulators.errors import SimulatorError
from simulators.world.sync_line import SyncLine
from simulators.world.world import LightState

#: What can go wrong with the light, by name.
LAMP_FAULTS: Final = {
    "lamp_open": "the lamp no longer lights; its driver does not notice",
    "dim": "the lamp gives only a share of its light",
    "wrong_frequency": "the flicker runs at another frequency than the driver says, by a factor",
    "wrong_duty": "the high part of a period has another share than the driver says, by a factor",
    "no_sync": "sync edges no longer reach the camera",
    "sync_inverted": "the sync line carries high for low",
    "sync_missing": "both sync edges are lost every so many periods, by the factor",
    "sync_extra": "a stray sync pulse comes every so many periods, by the factor",
    "sync_jitter": "sync edges come early or late by up to a share of a period, by the factor",
}


@dataclass(frozen=True)
class _Effect:
    """What the faults so far make of the driver's light."""

    brightness: float = 1.0
    frequency: float = 1.0
    duty: float = 1.0
    sync: bool = True
    line: SyncLine = field(default_factory=SyncLine)
    jitter: float = 0.0


_EFFECTS: Final[Mapping[str, Callable[[_Effect, float], _Effect]]] = {
    "lamp_open": lambda effect, _factor: replace(effect, brightness=0.0),
    "dim": lambda effect, factor: replace(effect, brightness=factor),
    "wrong_frequency": lambda effect, factor: replace(effect, frequency=factor),
    "wrong_duty": lambda effect, factor: replace(effect, duty=factor),
    "no_sync": lambda effect, _factor: replace(effect, sync=False),
    "sync_inverted": lambda effect, _factor: replace(effect, line=replace(effect.line, inverted=True)),
    "sync_missing": lambda effect, factor: replace(
        effect, line=replace(effect.line, missing_every=max(1, round(factor)))
    ),
    "sync_extra": lambda effect, factor: replace(
        effect, line=replace(effect.line, extra_every=max(1, round(factor)))
    ),
    "sync_jitter": lambda effect, factor: replace(effect, jitter=factor),
}


class Lamp:
    """A lamp and its cables.

    Parameters
    ----------
    show
        Called with the light that there is, whenever it changes.
    """

    def __init__(self, show: Callable[[LightState], None]) -> None:
        self._show = show
        self._driven = LightState()
        self._effect = _Effect()

    def drive(self, state: LightState) -> None:
        """Be driven so from now on."""
        self._driven = state
        effect = self._effect
        self._show(
            replace(
                state,
                low_v=state.low_v * effect.brightness,
                high_v=state.high_v * effect.brightness,
                frequency_hz=state.frequency_hz * effect.frequency,
                duty_percent=min(99.0, state.duty_percent * effect.duty),
                sync=state.sync and effect.sync,
                sync_line=replace(effect.line, jitter_us=effect.jitter * state.period_us / effect.frequency),
            )
        )

    def inject_fault(self, kind: str, factor: float = 0.5) -> None:
        """Let something go wrong from now on.

        Parameters
        ----------
        kind
            One of `LAMP_FAULTS`.
        factor
            Of brightness, frequency or duty, number of periods, or share of a period, where the fault has one.

        Raises
        ------
        SimulatorError
            When there is no such fault, or the factor is not positive.
        """
        if kind not in LAMP_FAULTS:
            raise SimulatorError(f"No lamp fault {kind!r}.", remedy=f"Known are: {', '.join(LAMP_FAULTS)}.")
        if factor <= 0.0:
            raise SimulatorError(f"A factor of {factor}.", remedy="Give a positive one.")
        self._effect = _EFFECTS[kind](self._effect, factor)
        self.drive(self._driven)

    def clear_faults(self) -> None:
        """Have all well again."""
        self._effect = _Effect()
        self.drive(self._driven)
