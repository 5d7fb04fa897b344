"""Safe points: between two pieces of work a run stops, holds or skips poses, as the operator asked.

`bench.run.control` receives the commands; this module acts on what they left in the history.
"""

from __future__ import annotations

from collections.abc import Callable

from bench.base.clock import BenchClock
from bench.plan.job import Job
from bench.plan.script_steps import ParkStep, ScriptStep
from bench.records.events import Event
from bench.records.run_log import RunLog
from bench.run.interlocks import Interlocks
from bench.run.machine import RunMachine
from bench.run.resumption import steps_of_pose
from bench.run.steps import Steps


class SafePoints:
    """The safe points of one run.

    steps: Repeats steps after a hold.
    interlocks: All of them must be clear before a run continues.
    """

    def __init__(
        self,
        job: Job,
        log: RunLog,
        machine: RunMachine,
        steps: Steps,
        interlocks: Interlocks,
        clock: BenchClock,
        say: Callable[[str], None],
    ) -> None:
        self._job = job
        self._log = log
        self._machine = machine
        self._steps = steps
        self._interlocks = interlocks
        self._clock = clock
        self._say = say
        self._steps_skipped: dict[int, set[int]] = {}

    def reach(self, step: ScriptStep) -> None:
        """Stop, hold or skip poses, as asked, before a step.

        Raises Aborted: When a stop was asked for.
        Raises Interrupted: When an interlock holds.
        """
        self._clock.check()
        self._interlocks.require_clear()
        history = self._log.history
        holder = history.holder
        if holder and self._machine.can("hold"):
            self._hold(step, holder)
        accepted = history.accepted()
        for pose_index, by in list(history.to_skip.items()):
            if pose_index not in history.skipped and pose_index not in accepted:
                self.skip(pose_index, f"{by} asked for it")
        if holder and not self.is_skipped(step):
            self._steps.prepare_again(step)

    def skip(self, pose_index: int, why: str) -> None:
        """Skip a pose: its steps will not be done.

        pose_index: Number of the pose, from 1.
        """
        name = self._job.record_step(pose_index).pose.name
        what = f"Pose {pose_index} ({name}) was skipped: {why}."
        self._log.write(Event.POSE_SKIPPED, pose=pose_index, pose_name=name, what=what)
        self._say(what)

    def is_skipped(self, step: ScriptStep) -> bool:
        """Return whether a step belongs to a skipped pose alone, or is not needed because its ``until`` ended.

        Returns: True where the step must not be done.
        """
        for pose in self._log.history.skipped.keys() - self._steps_skipped.keys():
            self._steps_skipped[pose] = {s.number for s in steps_of_pose(self._job.steps, pose)}
        if self._log.history.is_left_out(step.number):
            return True
        return any(step.number in numbers for numbers in self._steps_skipped.values())

    def _hold(self, step: ScriptStep, by: str) -> None:
        begin_s = self._clock.monotonic()
        self._say(f"Held by {by}. To continue: `starbench release`.")
        self._machine.fire("hold", step, by=by)
        held_s = self._clock.monotonic() - begin_s
        before = "parking" if isinstance(step, ParkStep) else f"step {step.number}"
        self._log.write(Event.DEVIATION, what=f"Held by {by} for {held_s:.0f} s before {before}.")
