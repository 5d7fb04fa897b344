"""Watches one worker process, and makes the bench safe where it cannot do that itself any more.

The worker's thread that takes commands also gives a heartbeat. A worker that ends is noticed at once, one that stands
still (stopped, or stuck where not even its threads run) within ``SILENCE_S``: it is ended by SIGABRT, at which it
writes down where it stood, or else by SIGKILL; the devices it had are opened anew and made safe. Knows no queue.
"""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.clock import Aborted, BenchClock
from bench.control import heartbeat
from bench.devices import make_orphans_safe
from bench.run_folder import STATION_COPY
from bench.station import load_station
from sequences.errors import DocumentFaults

SILENCE_S = 4.0
"""Longer without a heartbeat is hung; it is looked at every ``POLL_S``, so that 5 s are not exceeded."""
QUIET_S = 600.0
"""So long may it begin, end or seal without a heartbeat: what it does with devices then has deadlines of its own."""
POLL_S = 0.2
_LAST_WORDS_S = 2.0
_SAFE_END_S = 60.0
_ENDS = {0: "finished", 3: "aborted"}


@dataclass(frozen=True)
class WorkerEnd:
    """How a worker ended.

    Attributes
    ----------
    how
        ``finished``, ``aborted``, ``failed``; ``died`` by a signal; ``hung`` and was ended.
    why
        In words; the last line it said, where it failed.
    noticed_s
        How long it had been silent when it was ended as hung, s; 0 otherwise.
    unsafe
        Devices that a dead worker left and that did not confirm that they are safe.
    """

    how: str
    why: str
    noticed_s: float = 0.0
    unsafe: Sequence[str] = ()


def supervise(
    command: Sequence[str], folder: Path, log: Path, clock: BenchClock, say: Callable[[str], None]
) -> WorkerEnd:
    """Run a worker to its end.

    Parameters
    ----------
    command
        Its program and words.
    folder
        The run folder it works on, made by itself.
    log
        Where what it says is appended.
    clock
        A stop asked of it ends the worker, safely, and is raised again.
    say
        Told what the operator must know.

    Raises
    ------
    Aborted
        When a stop was asked for; the worker has ended by then.
    OSError
        When the program cannot be started.
    """
    with log.open("ab") as sink:
        worker = subprocess.Popen(
            list(command), stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, start_new_session=True
        )
    silent_s = 0.0
    try:
        silent_s = _watch(worker, folder, clock)
    except Aborted:
        _end_safely(worker)
        raise
    finally:
        with clock.shielded():
            if worker.poll() is None:
                _end_now(worker)
            killed = worker.returncode < 0
            unsafe = make_safe_after(folder, clock) if killed else []
            for fault in unsafe:
                say(f"CHECK THE BENCH: {fault}")
    if silent_s:
        return WorkerEnd("hung", f"gave no sign of life for {silent_s:.1f} s", silent_s, unsafe)
    if killed:
        return WorkerEnd("died", f"by {signal.Signals(-worker.returncode).name}", 0.0, unsafe)
    how = _ENDS.get(worker.returncode, "failed")
    return WorkerEnd(how, "" if how == "finished" else _last_line(log))


def make_safe_after(folder: Path, clock: BenchClock) -> list[str]:
    """Make the devices safe that a dead worker had; return what could not be, in words."""
    if not (folder / STATION_COPY).is_file():  # it died before it could open any
        return []
    try:
        return make_orphans_safe(load_station(str(folder / STATION_COPY)).value, clock)
    except DocumentFaults as error:
        return [f"the station file of {folder} cannot be read: {error}"]


def _watch(worker: subprocess.Popen[bytes], folder: Path, clock: BenchClock) -> float:
    """Wait for the worker's end; return how long it had been silent where it hangs, else 0."""
    left_over = last = heartbeat(folder)
    since_s = clock.monotonic()
    while worker.poll() is None:
        clock.sleep(POLL_S)
        beat, now_s = heartbeat(folder), clock.monotonic()
        patience_s = QUIET_S if beat in {None, left_over} else SILENCE_S
        if beat != last:
            last, since_s = beat, now_s
        elif now_s - since_s > patience_s:
            return now_s - since_s
    return 0.0


def _end_safely(worker: subprocess.Popen[bytes]) -> None:
    """Ask the worker to end, and give it the time that takes."""
    worker.send_signal(signal.SIGTERM)
    with suppress(subprocess.TimeoutExpired):
        worker.wait(_SAFE_END_S)


def _end_now(worker: subprocess.Popen[bytes]) -> None:
    """End a worker that does not answer; first let it write down where it stands."""
    worker.send_signal(signal.SIGABRT)
    worker.send_signal(signal.SIGCONT)
    try:
        worker.wait(_LAST_WORDS_S)
    except subprocess.TimeoutExpired:
        worker.kill()
        worker.wait()


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    said = [line for line in lines if line.startswith(("The run ", "starbench: "))]
    return (said or lines or [""])[-1][:500]
