"""Supervises one worker process, and makes the bench safe if the worker cannot do so any more.

The end of a worker is noticed at once, a hang within ``SILENCE_S`` (docs/decisions/0021-survival.md). A hanging
worker is ended by SIGABRT, at which it writes its position in the program to a file, or else by SIGKILL; then its
devices are opened again and made safe. A worker whose supervisor was killed is supervised by the next one.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bench.base.clock import Aborted, BenchClock
from bench.base.supervised import SUPERVISOR
from bench.record.device_end import DeviceEnd, all_ends, lost_ends, unsafe_devices
from bench.record.folder_lock import is_locked
from bench.record.run_folder import STATION_COPY
from bench.run.crash_log import write_crash_log
from bench.run.heartbeat import Heartbeat, open_process, read_heartbeat
from bench.run.processes import out_of_memory_kills, waits_for_disk
from bench.stations.orphans import make_orphans_safe
from bench.stations.station import load_station
from sequences.errors import DocumentFaults

SILENCE_S = 9.0
"""A worker hangs if it gives no sign of life for this time, s. The bench is safe some 4 s later: 2 s for the worker's
last words, and what its devices take to be opened and stopped."""
QUIET_S = 600.0
"""Time without a sign of life that is allowed at the start, at the end and while sealing, s. The devices' own deadlines
apply there."""
POLL_S = 0.2  # Short against `SILENCE_S`
OUT_OF_MEMORY = "ended by the system because memory ran out"
_LAST_WORDS_S = 2.0  # See `SILENCE_S`
_SAFE_END_S = 60.0
"""Longest wait for a process that makes its devices safe, or was killed, s: motions and lights need some seconds."""
_HIGH_LOAD = 4.0
"""A load of more than this for each processor is told as a possible cause of a silence: a program gets less than a
quarter of one."""
_ENDS = {0: "finished", 3: "aborted", 4: "finished"}
"""How a run ended, by the exit status of its process; 4: it finished, and does not keep its limits."""
_STOPPED = 128 + signal.SIGINT  # Before its run began, or by the third Ctrl-C
_FROM_OUTSIDE = frozenset({"SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", "SIGQUIT", "SIGPWR"})
"""Signals that a process does not get by its own error; a lack of memory also sends SIGKILL, and is told apart."""


@dataclass(frozen=True)
class WorkerEnd:
    """How a worker ended."""

    how: str  # ``finished``, ``aborted`` or ``failed``; ``died`` by a signal; ``hung`` and was ended
    why: str  # The reason in words; the last message of the worker if it failed
    noticed_s: float = 0.0  # How long the worker had been silent when it was ended as hung, s; otherwise 0
    # What the devices of a dead worker answered after its end; empty if none was asked.
    devices: Sequence[DeviceEnd] = ()
    # Whether something else than the worker may have ended it: a signal of another process, or a computer that
    # is very busy. It is no failure of the run.
    outside: bool = False

    @property
    def unsafe(self) -> list[str]:
        """A sentence for stage and light each, if it did not confirm that it is safe."""
        return unsafe_devices(self.devices)

    def to_dict(self) -> dict[str, Any]:
        """Return the end as JSON holds it: ``how``, ``why``, ``noticed_s``, ``unsafe``, ``outside``, ``devices``."""
        return {**asdict(self), "unsafe": self.unsafe}


def supervise(
    command: Sequence[str],
    folder: Path,
    log: Path,
    clock: BenchClock,
    say: Callable[[str], None],
) -> WorkerEnd:
    """Run a worker to its end. A stop requested from the clock ends it safely, then is raised again as `Aborted`."""
    killed_for_memory = out_of_memory_kills()
    try:
        with log.open("ab") as sink:
            worker = _Child(
                subprocess.Popen(
                    list(command),
                    stdin=subprocess.DEVNULL,
                    stdout=sink,
                    stderr=sink,
                    start_new_session=True,
                    env={**os.environ, SUPERVISOR: str(os.getpid())},
                )
            )
    except OSError as error:  # no memory, no room, too many processes: the next one may begin
        return WorkerEnd("failed", f"its process could not be started: {error}")
    silent_s, devices = _supervise_worker(worker, folder, clock, say)
    if silent_s:
        return _hung(silent_s, devices)
    status = worker.process.returncode
    if status == _STOPPED:
        return WorkerEnd("died", "by SIGTERM or Ctrl-C", 0.0, devices, outside=True)
    if status < 0:
        name = signal.Signals(-status).name
        why, outside = f"by {name}", name in _FROM_OUTSIDE
        if status == -signal.SIGKILL and out_of_memory_kills() > killed_for_memory:
            why, outside = OUT_OF_MEMORY, False
            write_crash_log(folder, OUT_OF_MEMORY)
        return WorkerEnd("died", why, 0.0, devices, outside)
    how = _ENDS.get(status, "failed")
    return WorkerEnd(how, "" if how == "finished" else _last_message(log))


def adopt(folder: Path, clock: BenchClock, say: Callable[[str], None]) -> WorkerEnd | None:
    """Supervise a worker that outlived its supervisor, to its end; return how it was ended if it hung, else None.

    Returns at once if the folder's lock shows none. A stop requested from the clock ends the worker safely.
    """
    if not is_locked(folder):
        return None
    silent_s, devices = _supervise_worker(_Orphan(folder), folder, clock, say)
    return _hung(silent_s, devices) if silent_s else None


def make_safe_after(folder: Path, clock: BenchClock) -> list[DeviceEnd]:
    """Make the devices of a dead worker safe; empty if they were simulated and have ended with it."""
    if not (folder / STATION_COPY).is_file():  # it died before it could open a device
        return all_ends(())
    try:
        return make_orphans_safe(load_station(str(folder / STATION_COPY)).value, clock)
    except DocumentFaults as error:
        return lost_ends(f"the station file of {folder} cannot be read: {error}")


@dataclass
class _Child:
    """A worker of our own."""

    process: subprocess.Popen[bytes]

    def gone(self) -> bool:
        return self.process.poll() is not None

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def wait(self, seconds: float) -> bool:
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)
        return self.gone()

    def killed(self) -> bool:
        """Whether it ended by a signal, or may have: then nobody has made its devices safe."""
        return self.process.returncode < 0 or self.process.returncode == _STOPPED


@dataclass
class _Orphan:
    """A worker whose supervisor is gone: the folder's lock shows that it lives, its sign of life names its process."""

    folder: Path
    ended_by_us: bool = field(default=False, init=False)

    def gone(self) -> bool:
        return not is_locked(self.folder)

    def send(self, number: signal.Signals) -> None:
        sign = read_heartbeat(self.folder)
        process = open_process(sign) if sign is not None else None
        if process is None:
            return
        self.ended_by_us |= number in {signal.SIGABRT, signal.SIGKILL}
        try:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(process, number)
        finally:
            os.close(process)

    def wait(self, seconds: float) -> bool:
        waited_s = 0.0
        while not self.gone() and waited_s < seconds:
            select.select([], [], [], POLL_S)
            waited_s += POLL_S
        return self.gone()

    def killed(self) -> bool:
        return self.ended_by_us


def _supervise_worker(
    worker: _Child | _Orphan, folder: Path, clock: BenchClock, say: Callable[[str], None]
) -> tuple[float, list[DeviceEnd]]:
    """Supervise a worker to its end; return its silence, s, if it hung, and what the devices of a dead one say."""
    silent_s, devices = 0.0, []
    try:
        silent_s = _watch(worker, folder, clock)
    except Aborted:
        worker.send(signal.SIGTERM)
        worker.wait(_SAFE_END_S)
        raise
    finally:
        with clock.shielded():
            if not worker.gone():
                _end_now(worker)
            devices = make_safe_after(folder, clock) if worker.killed() else []
            for fault in unsafe_devices(devices):
                say(f"CHECK THE BENCH: {fault}")
    return silent_s, devices


def _watch(worker: _Child | _Orphan, folder: Path, clock: BenchClock) -> float:
    """Wait for the worker's end; return how long it has been silent if it hangs, otherwise 0 s."""
    left_over = last = read_heartbeat(folder)
    if isinstance(worker, _Orphan):
        left_over = None
    since_s = clock.monotonic()
    while not worker.gone():
        clock.sleep(POLL_S)
        sign, now_s = read_heartbeat(folder), clock.monotonic()
        if sign != last:
            last, since_s = sign, now_s
        silent_s = now_s - since_s
        if silent_s > (SILENCE_S if _is_due(sign, left_over) else QUIET_S):
            return silent_s
    return 0.0


def _hung(silent_s: float, devices: Sequence[DeviceEnd]) -> WorkerEnd:
    """Return the end of a worker that was silent for so long, with the load of the computer as a possible cause."""
    load = os.getloadavg()[0]
    is_busy = load > _HIGH_LOAD * (os.cpu_count() or 1)
    why = f"gave no sign of life for {silent_s:.1f} s"
    if is_busy:
        why += f"; this computer is very busy (load {load:.0f}), which may be the cause"
    return WorkerEnd("hung", why, silent_s, devices, outside=is_busy)


def _is_due(sign: Heartbeat | None, left_over: Heartbeat | None) -> bool:
    """Whether another sign of life is due: not while a thread waits for the disk, which may delay the sign itself."""
    return sign is not None and sign != left_over and not waits_for_disk(sign.pid)


def _end_now(worker: _Child | _Orphan) -> None:
    """End a worker that does not respond, after it had a chance to write its position to a file."""
    worker.send(signal.SIGABRT)
    worker.send(signal.SIGCONT)
    if not worker.wait(_LAST_WORDS_S):
        worker.send(signal.SIGKILL)
        worker.wait(_SAFE_END_S)


def _last_message(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    messages = [line for line in lines if line.startswith(("The run ", "starbench: "))]
    return (messages or lines or [""])[-1][:500]
