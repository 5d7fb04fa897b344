"""Take single steps of a script through the state machine, and set up light and stage again after a hold.

The runner decides which step comes next; `bench.run.attempts` decides how often a recording is tried.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Unpack

from bench.plan.job import Job
from bench.plan.script_steps import ParkStep, ScriptStep
from bench.records.events import Circumstances
from bench.records.run_log import RunLog
from bench.run.machine import RunMachine
from bench.run.resumption import steps_to_repeat
from sequences.script import (
    ChooseStep,
    LightStep,
    MoveStep,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    WaitStep,
)

_TRIGGERS: Mapping[type, str] = {
    LightStep: "set_light",
    MoveStep: "slew",
    SettleStep: "settle",
    WaitStep: "wait",
    PromptStep: "hold",
    ChooseStep: "choose",
    ParkStep: "park",
    SolveStep: "solve",
    ReportStep: "report",
}
"""The edge that a step takes; a RecordStep takes several."""


class Steps:
    """Steps of one run's script.

    log: The run's journal, which holds the poses that the run has chosen.
    machine: The run's state machine.
    """

    def __init__(self, job: Job, log: RunLog, machine: RunMachine) -> None:
        self._job = job
        self._log = log
        self._machine = machine

    def take(self, step: ScriptStep) -> None:
        """Take the one edge of a step that records nothing."""
        if isinstance(step, MoveStep):
            step = self._job.at_its_pose(step, self._log.history.chosen)
            self.fire_at("slew", step, target_deg=dict(step.pose.angles_deg))
        else:
            self._machine.fire(_TRIGGERS[type(step)], step)

    def fire_at(
        self, trigger: str, step: MoveStep | RecordStep, **circumstances: Unpack[Circumstances]
    ) -> None:
        """Take an edge for a step at its pose."""
        at_pose: Circumstances = {"pose": step.pose.index, "pose_name": step.pose.name, **circumstances}
        self._machine.fire(trigger, self._job.at_its_pose(step, self._log.history.chosen), **at_pose)

    def set_light(self, light: LightStep) -> None:
        """Set the light as a light step specifies, whether or not the script has reached that step."""
        self._machine.fire("set_light", light)

    def prepare_again(self, step: ScriptStep) -> None:
        """Set up the bench again after a hold: the light, and the move and settling that the next recording needs."""
        here = self._job.index_of(step)
        left_out = self._log.history.is_left_out
        coming = (later for later in self._job.steps[here:] if not left_out(later.number))
        if not any(isinstance(later, RecordStep) for later in coming):
            return
        light = self._job.light_before(step)
        if light is not None and not isinstance(step, LightStep):
            self.set_light(light)
        for needed in steps_to_repeat(self._job.steps, step):
            self.take(needed)
