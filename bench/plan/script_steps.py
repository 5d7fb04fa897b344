"""The steps of a script with parking after the last step that needs devices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from sequences.script import ChooseStep, LightStep, MoveStep, RecordStep, SettleStep, Step


@dataclass(frozen=True)
class ParkStep:
    """Light off and stage to zero, after the last step that needs devices. No script contains this step."""

    number: int = 0  # Number of the step; 0, because it is not in the script
    where: str = "after the last recording"


ScriptStep = Step | ParkStep
PoseStep = TypeVar("PoseStep", bound=MoveStep | RecordStep)
DEVICE_STEPS = (LightStep, MoveStep, SettleStep, RecordStep, ChooseStep, ParkStep)


def with_parking(steps: Sequence[Step]) -> tuple[ScriptStep, ...]:
    """Insert a park step after the last step that needs devices.

    Returns: Steps with the park step; unchanged if no step needs devices.
    """
    last = max((i for i, step in enumerate(steps) if isinstance(step, DEVICE_STEPS)), default=-1)
    if last < 0:
        return tuple(steps)
    return (*steps[: last + 1], ParkStep(), *steps[last + 1 :])
