"""Devices of one run: opened when the first step needs them, opened again after a loss, made safe at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from bench.measure.camera_kinds import event_camera
from bench.plan.job import Job
from bench.record import events
from bench.record.device_end import NOT_ASKED, DeviceEnd, all_ends, lost_ends, unsafe_devices
from bench.record.run_folder import RunFolder
from bench.record.run_log import RunLog
from bench.record.storage import storage_errors
from bench.run.interlocks import (
    loss_text,
)
from bench.stations.devices import Devices, left_devices
from drivers.errors import DriverError, WrongDevice

PROBE = "probe.raw"
"""File of a short recording in the dark; it is never kept."""

NOT_REOPENED = "the devices were lost and could not be opened again; nothing confirmed a safe state"
"""Fault of a run that ended while its devices were lost."""


class RunDevices:
    """Stage, light and camera of a run; ``unsafe`` names stage and light if they did not confirm a safe state."""

    def __init__(
        self,
        job: Job,
        folder: RunFolder,
        log: RunLog,
        open_devices: Callable[[], Devices],
        say: Callable[[str], None],
    ) -> None:
        self.unsafe: list[str] = []
        self.was_opened = False
        self._tried = False
        self._is_event_camera = job.camera_kind.name == "event"
        self._folder = folder
        self._log = log
        self._open_devices = open_devices
        self._say = say
        self._devices: Devices | None = None
        self._made_safe = False
        self._ends: list[DeviceEnd] = []
        self._attempts_with_rate_checked = 0

    @property
    def opened(self) -> Devices:
        """The open devices; the state machine has no edge to a state that needs them before preflight."""
        assert self._devices is not None
        return self._devices

    @property
    def is_open(self) -> bool:
        """Whether the devices are open."""
        return self._devices is not None

    def open(self) -> Devices:
        """Open the devices, unless they are open."""
        if self._devices is None:
            self._tried = True
            try:
                self._devices = self._open_devices()
            except BaseException as error:
                self._ends = left_devices(error)
                raise
            self.was_opened = True
        return self._devices

    def truth(self) -> Mapping[str, Any] | None:
        """Return the truth of the simulated bench; None on a real bench, and where no device is open."""
        return self._devices.truth() if self._devices is not None else None

    def position_deg(self) -> dict[str, float]:
        """Read angle by axis, degrees, and ``{axis}_encoder`` where an axis has an encoder."""
        stage = self.opened.stage
        return {**stage.position_deg(), **{f"{axis}_encoder": a for axis, a in stage.encoder_deg().items()}}

    # ------------------------------------------------------------------ safety

    def switch_off_light(self) -> None:
        """Switch the light off, if devices are open. Raises DriverError when the light does not confirm."""
        if self._devices is not None:
            self._devices.light.off()

    def come_to_rest(self) -> None:
        """Stop the stage, switch the light off, stop the camera. A device that does not confirm becomes a deviation."""
        if self._devices is not None:
            for fault in self._devices.make_safe():
                self._say(f"CHECK THE BENCH: {fault}")
                self._log.write(events.Deviation, what=f"While the run held: {fault}")

    def make_safe(self) -> None:
        """Make all devices safe once, each independently; never raises. ``unsafe`` names what did not confirm."""
        if not self.was_opened or self._made_safe:
            return
        self._made_safe = True
        try:
            self._ends = lost_ends(NOT_REOPENED) if self._devices is None else self._devices.make_each_safe()
        except KeyboardInterrupt:
            self._say(
                "CHECK THE BENCH: ended by Ctrl-C before stage, light and camera confirmed that they are safe."
            )
            raise
        self.unsafe = unsafe_devices(self._ends)
        for fault in self.unsafe:
            self._say(f"CHECK THE BENCH: {fault}")

    def leave(self) -> None:
        """Stop the stage, switch the light off, stop the camera, journal what each confirmed; all stay open."""
        history = self._log.history
        if self._devices is not None:
            ends = all_ends(self._devices.make_each_safe())
        else:
            ends = list(history.devices_at_end) or lost_ends(NOT_ASKED)
        self._log.write(events.DevicesLeft, devices=[asdict(end) for end in ends])

    def ends(self) -> list[DeviceEnd]:
        """Return how the run leaves each device, as far as anything is known: by an earlier process if it used none."""
        history = self._log.history
        stated = () if self._tried else history.devices_at_end or history.devices_left
        return list(stated) or all_ends(self._ends)

    def close(self) -> None:
        """Close the ports; nothing moves."""
        if self._devices is not None:
            self._devices.close()

    # ------------------------------------------------------------------ what interlocks read

    def reopen(self) -> str:
        """Open all devices again, with the serial numbers they had; nothing moves. Returns why one is not open yet."""
        if self._devices is not None:
            self._devices.close()
            self._devices = None
        try:
            self._devices = self._open_devices()
        except WrongDevice:
            raise
        except DriverError as error:
            return loss_text(error)
        self.come_to_rest()
        return ""

    def camera_c(self) -> float | None:
        """Read the temperature of the event camera's sensor, degrees Celsius; None if it is not known."""
        if self._devices is None or not self._is_event_camera:
            return None
        return event_camera(self._devices.camera).temperature_c()

    def last_mev_s(self) -> float:
        """Return the event rate of the last recording, millions a second; 0 without one, or after a dark one."""
        attempts = self._log.history.attempts
        if len(attempts) <= self._attempts_with_rate_checked:
            return 0.0
        return _rate_mev_s(attempts[-1].stored["facts"])

    def dark_mev_s(self, duration_s: float) -> float:
        """Measure the event rate in the dark, millions a second, by a short recording that is not kept."""
        self._attempts_with_rate_checked = len(self._log.history.attempts)
        if not self._is_event_camera:
            return 0.0
        part = self._folder.part_path(PROBE)
        try:
            facts = event_camera(self.opened.camera).record(part, duration_s)
        finally:
            with storage_errors(part):
                part.unlink(missing_ok=True)
        return _rate_mev_s(asdict(facts))


def _rate_mev_s(facts: Mapping[str, Any]) -> float:
    duration_s = facts.get("duration_s") or 0.0
    return facts.get("events", 0) / duration_s / 1e6 if duration_s else 0.0
