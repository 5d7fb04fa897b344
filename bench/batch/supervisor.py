"""Supervises one worker process, and makes the bench safe if the worker cannot do so any more.

A worker gives signs of life (`bench.run.heartbeat`). The supervisor notices at once that a worker has ended, and within
``SILENCE_S`` that it hangs: it is stopped, deadlocked, or in a driver that never returns. A hanging worker is ended by
SIGABRT, at which it writes its position in the program to a file, or else by SIGKILL. Then its devices are opened again
and made safe. A worker whose supervisor was killed is supervised by the next one in the same way.

A worker that is ready to compute while other programs have the processors does not hang. This time is not counted as
silence; after ``MOST_STARVED_S`` of it the worker is ended all the same, told as a computer that is too busy.

A driver that computes without end uses the processors, if only little on a busy computer. It is known by its processor
time (`bench.batch.endless_computing`).
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from bench.base.clock import Aborted, BenchClock
from bench.base.device_ends import DeviceEnd, all_ends, lost_ends, unsafe_devices
from bench.base.linux_process import out_of_memory_kills, waits_for_disk
from bench.batch.endless_computing import EndlessComputing
from bench.batch.starvation import Starvation
from bench.records.folder_lock import is_locked
from bench.records.run_folder import STATION_COPY
from bench.run.crash_log import write_crash_log
from bench.run.heartbeat import MOST_STARVED_S, SUPERVISOR, Heartbeat, open_process, read_heartbeat
from bench.stations.orphans import make_orphans_safe
from bench.stations.station import load_station
from drivers.lateness import REMEDY
from sequences.errors import DocumentFaults

SILENCE_S = 3.5
"""A worker hangs if it gives no sign of life for this time, s."""
LATE_S = 0.8
"""Where the kernel does not count how long a worker waited for a processor, the limit grows by at most this time with
the lateness of this process, s. With the period ``POLL_S``, 5 s are not exceeded."""
QUIET_S = 600.0
"""Time without a sign of life that is allowed at the start, at the end and while sealing, s. The devices' own deadlines
apply there."""
POLL_S = 0.2
OUT_OF_MEMORY = "ended by the system because memory ran out"
_LAST_WORDS_S = 2.0
_SAFE_END_S = 60.0
_ENDS = {0: "finished", 3: "aborted"}
_FROM_OUTSIDE = frozenset({"SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", "SIGQUIT", "SIGPWR"})
"""Signals that a process does not get by its own error; a lack of memory also sends SIGKILL, and is told apart."""


@dataclass(frozen=True)
class Silence:
    """How long a worker had been silent when it was ended."""

    silent_s: float = 0.0  # Time without a sign of life, s; 0 if the worker ended by itself
    starved_s: float = 0.0  # Part of it in which the worker waited for nothing but a processor, s
    # Processor time that its work used without using its clock, s; 0 unless it was ended for this.
    computed_s: float = 0.0

    @property
    def is_starved(self) -> bool:
        """Whether the computer was too busy for the worker, rather than the worker hung."""
        return self.starved_s >= MOST_STARVED_S

    @property
    def text(self) -> str:
        """Why the worker was ended, as a sentence without a full stop."""
        if self.is_starved:
            return (
                f"this computer is too busy: the process had no processor for {self.starved_s:.0f} of"
                f" {self.silent_s:.0f} s. {REMEDY.split(';', maxsplit=1)[0]}"
            )
        if self.computed_s:
            return f"computed without progress for {self.silent_s:.1f} s"
        return f"gave no sign of life for {self.silent_s:.1f} s"

    def end(self, devices: Sequence[DeviceEnd] = ()) -> WorkerEnd:
        """Return the end of the worker.

        devices: What its devices answered after its end.
        """
        return WorkerEnd("hung", self.text, self.silent_s, devices, self.is_starved)


@dataclass(frozen=True)
class WorkerEnd:
    """How a worker ended."""

    how: str  # ``finished``, ``aborted`` or ``failed``; ``died`` by a signal; ``hung`` and was ended
    why: str  # The reason in words; the last message of the worker if it failed
    noticed_s: float = 0.0  # How long the worker had been silent when it was ended as hung, s; otherwise 0
    # What the devices of a dead worker answered after its end; empty if none was asked.
    devices: Sequence[DeviceEnd] = ()
    # Whether something else than the worker ended it: a signal of another process, or a computer that was too
    # busy. It is no failure of the run.
    outside: bool = False

    @property
    def unsafe(self) -> list[str]:
        """A sentence for stage and light each, if it did not confirm that it is safe."""
        return unsafe_devices(self.devices)

    def to_dict(self) -> dict[str, Any]:
        """Return the end as the journal holds it.

        Returns: ``how``, ``why``, ``noticed_s``, ``unsafe``, ``outside``, ``devices``.
        """
        return {**asdict(self), "unsafe": self.unsafe, "devices": [end.to_dict() for end in self.devices]}


def supervise(
    command: Sequence[str],
    folder: Path,
    log: Path,
    clock: BenchClock,
    say: Callable[[str], None],
    environ: Mapping[str, str] = os.environ,
) -> WorkerEnd:
    """Run a worker to its end.

    log: File to which the worker's output is appended.
    clock: If a stop is requested from it, the worker is ended safely and the stop is raised again.
    say: Receives what the operator must know.
    environ: Environment of the worker; the process id of its supervisor is added.
    Raises Aborted: When a stop was requested; the worker has ended by then.
    """
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
                    env={**environ, SUPERVISOR: str(os.getpid())},
                )
            )
    except OSError as error:  # no memory, no room, too many processes: the next one may begin
        return WorkerEnd("failed", f"its process could not be started: {error}")
    silence, devices = _supervise_worker(worker, folder, clock, say)
    if silence.silent_s:
        return silence.end(devices)
    status = worker.process.returncode
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
    """Supervise a worker that outlived its supervisor, to its end. Return at once if there is none.

    folder: Run folder; its lock shows whether a worker is alive. The folder records how the worker ended.
    clock: If a stop is requested from it, the worker is ended safely and the stop is raised again.
    say: Receives what the operator must know.
    Returns: How it was ended if it hung; None if it did not hang.
    Raises Aborted: When a stop was requested; the worker has ended by then.
    """
    if not is_locked(folder):
        return None
    silence, devices = _supervise_worker(_Orphan(folder), folder, clock, say)
    return silence.end(devices) if silence.silent_s else None


def make_safe_after(folder: Path, clock: BenchClock) -> list[DeviceEnd]:
    """Make the devices of a dead worker safe.

    Returns: What each device answered; empty if the devices are simulated and have ended with the worker.
    """
    if not (folder / STATION_COPY).is_file():  # it died before it could open a device
        return all_ends(())
    try:
        return make_orphans_safe(load_station(str(folder / STATION_COPY)).value, clock)
    except DocumentFaults as error:
        return lost_ends(f"the station file of {folder} cannot be read: {error}")


# ---------------------------------------------------------------- a worker, our own or another's


class _Worker(Protocol):
    """A process that works on a run."""

    def gone(self) -> bool:
        """Whether it has ended."""
        ...

    def send(self, number: signal.Signals) -> None:
        """Send it a signal if it is still there."""
        ...

    def wait(self, seconds: float) -> bool:
        """Wait for its end; return whether it has ended."""
        ...

    def killed(self) -> bool:
        """Whether it ended by a signal, or may have: then nobody has made its devices safe."""
        ...


@dataclass
class _Child:
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
        return self.process.returncode < 0


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
    worker: _Worker, folder: Path, clock: BenchClock, say: Callable[[str], None]
) -> tuple[Silence, list[DeviceEnd]]:
    """Supervise a worker to its end; return its silence if it hung, and what its devices answered if it was killed."""
    silence, devices = Silence(), []
    try:
        silence = _watch(worker, folder, clock)
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
    return silence, devices


def _watch(worker: _Worker, folder: Path, clock: BenchClock) -> Silence:
    """Wait for the worker's end; return how long it has been silent if it hangs, otherwise 0 s."""
    left_over = last = read_heartbeat(folder)
    if isinstance(worker, _Orphan):
        left_over = None
    since_s, lost_before_s, starvation = clock.monotonic(), _lost_s(clock), Starvation()
    computing = EndlessComputing()
    while not worker.gone():
        clock.sleep(POLL_S)
        sign, now_s = read_heartbeat(folder), clock.monotonic()
        if sign != last:
            last, since_s, lost_before_s, starvation = sign, now_s, _lost_s(clock), Starvation()
        if not _is_due(sign, left_over):
            computing.forget()
            if now_s - since_s > QUIET_S:
                return Silence(now_s - since_s)
            continue
        assert sign is not None
        computing.look(sign.pid, sign.work, now_s)
        if computing.is_endless(SILENCE_S):
            return Silence(computing.passed_s, computed_s=computing.computed_s)
        starved_s = starvation.look(sign.pid, (sign.pid, sign.thread), now_s)
        silence = Silence(now_s - since_s, starved_s)
        late_s = 0.0 if starvation.is_counted else min(LATE_S, _lost_s(clock) - lost_before_s)
        if silence.is_starved or silence.silent_s - starved_s > SILENCE_S + late_s:
            return silence
    return Silence()


def _lost_s(clock: BenchClock) -> float:
    """Return the time that a busy computer has not let this process use, s."""
    return float(clock.lateness().get("lost_s", 0.0))


def _is_due(sign: Heartbeat | None, left_over: Heartbeat | None) -> bool:
    """Whether another sign of life is due: not while a thread waits for the disk, which may delay the sign itself."""
    return sign is not None and sign != left_over and not waits_for_disk(sign.pid)


def _end_now(worker: _Worker) -> None:
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
