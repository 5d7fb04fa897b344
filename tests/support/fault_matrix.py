"""Every fault in every state where it can happen: what the run does, how long that takes, and what is left of it.

The run is the real one (steps, states, journal, storage) on virtual devices and a virtual clock; a fault is what a driver
raises or reports (that drivers raise it is shown with the simulated devices, byte for byte). Each run records two poses;
the first recording is refused, an operator holds it, then it waits, solves and reports: so every state is passed.
After a run that did not finish, the cause is removed and it is resumed: it must end with every pose recorded once.

    python tests/support/fault_matrix.py    # writes the table of docs/faults.md
"""

import sys
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from rehearsed import TWO, Scene, with_runner
from run_faults import FAULTS, Died, Fault, command, mortal

import bench.batch.rehearsal
from bench.base.clock import VirtualClock
from bench.record.events import Event
from bench.record.journal import read_journal, stored_captures
from bench.record.storage import sha256_of
from bench.run import machine
from bench.run.machine import END_STATES

STATES = tuple(
    state for state in machine.STATES if state not in {"idle", "choosing", "recovering", *END_STATES}
)
DOCUMENT = Path(__file__).parents[2] / "docs" / "faults.md"
END = "  - wait: {duration_s: 1}\n  - solve: {model: spherical, distortion: [k1]}\n  - report\n"
ORDERED_GAP = "a gap that belongs to every run here"
"""Why the first recording is refused; it tells of no fault."""
MOST_S = 120.0
"""A run that nothing befalls takes 15 s of virtual time, its hold included; none may take longer than that."""


@dataclass(frozen=True)
class Cell:
    """What became of one fault in one state.

    ``end`` is how the run ended; empty where the fault cannot happen there. ``seconds`` it took, all in all.
    """

    end: str
    why: str = ""
    seconds: float = 0.0
    wrong: tuple[str, ...] = ()


def strike(fault: Fault, state: str, folder: Path, patch: pytest.MonkeyPatch) -> Cell:
    """Let a fault strike the first call it can in a state; see what becomes of the run."""
    scene = with_runner(Scene(folder, station=fault.station, poses=TWO, end=END, attempts=3), patch)
    scene.struck_at_s = None
    struck = [0]
    refused = [False]

    def happens(name):
        if scene.dead:
            raise Died
        here = scene.runner is not None and scene.runner.state == state
        here |= state == "preflight" and name == "open" and scene.runner is not None and not struck[0]
        due = (here and (not struck[0])) or (fault.lasts and struck[0])
        if due and any(name.startswith(call) for call in fault.of):
            struck[0] += 1
            return fault.strike(scene)
        if (
            name == "camera.record" and not refused[0]
        ):  # the first recording is refused, so that there is a second
            refused[0] = True
            return lambda facts: replace(facts, gaps=(ORDERED_GAP,))
        return None

    scene.hook = happens
    if "disk" in fault.of:
        scene.disk = lambda: happens("disk")
    _with_a_hold(scene, happens, patch, stop_there=state == "aborting")
    try:
        end = scene.run(journal_type=mortal(scene))
        how, why = end.how, end.why
    except Died:
        how, why = "died", ""
    if not struck[0]:
        return Cell("")
    seconds = scene.clock.monotonic()
    wrong = _left_behind(scene, how, fault, state)
    if how != "finished":
        wrong += _resumed(scene, patch)
    if seconds > MOST_S:
        wrong.append(f"it took {seconds:.0f} s")
    if how not in fault.ends and state != "aborting":
        wrong.append(f"it {how}: {why}")
    return Cell(how, why, seconds, tuple(wrong))


def _with_a_hold(scene, happens, patch, *, stop_there):
    """Have an operator hold the run before its second pose, for some seconds; or stop it there."""
    sleep, orders = VirtualClock.sleep, []

    def passing(clock, seconds):
        runner = scene.runner
        if runner is not None and not scene.dead:
            if not orders and runner.state == "settling":
                orders.append("hold")
                if stop_there:
                    clock.request_stop("SIGTERM received")
                else:
                    command(scene, "hold")
            elif len(orders) == 1 and runner.state == "holding":
                orders.append("release")
                command(scene, "release")
        happens("tick")
        sleep(clock, seconds)

    patch.setattr(VirtualClock, "sleep", passing)


def _left_behind(scene, how, fault, state):
    """What is wrong with what a run left: evidence lost, light on, files half-written under a final name."""
    entries, _ = read_journal(scene.folder / "journal.jsonl")
    wrong = []
    for capture in stored_captures(entries).values():
        path = scene.folder / capture.name
        if not path.is_file() or sha256_of(path) != capture.sha256:
            wrong.append(f"{capture.name} is not what the journal tells")
    unreachable = fault.lasts or any(call.startswith("light") for call in fault.of)
    if how != "died" and scene.light_is_on() and not unreachable:
        wrong.append("the light is on")
    if how != "died" and fault.of != ("disk",):
        ended = [e.data for e in entries if e.event == Event.RUN_ENDED]
        if [data["how"] for data in ended[-1:]] != [how]:
            wrong.append("the journal does not tell its end")
        if how == "failed" and not ended[-1]["why"]:
            wrong.append("it does not say why")
    if how == "finished" and not _reported(entries):
        wrong.append("it does not report the fault")
    return wrong


def _reported(entries):
    """Whether the journal tells of a fault: a rejected or lost recording, a lost device, one that did not confirm."""
    for entry in entries:
        event, data = entry.event, entry.data
        if event in {Event.ATTEMPT_LOST, Event.INTERLOCK_RELEASED}:
            return True
        if event == Event.ATTEMPT_CHECKED and any(ORDERED_GAP not in reason for reason in data["reasons"]):
            return True
        if event == Event.DEVICES_LEFT and any(end["state"] != "confirmed safe" for end in data["devices"]):
            return True
    return False


def _resumed(scene, patch):
    """Remove the cause, resume; what is wrong with the end."""
    scene.hook, scene.dead, scene.disk = (lambda _name: None), False, (lambda: None)
    patch.undo()
    with_runner(scene, patch)
    _quick_solution(patch)
    end = scene.run()
    accepted = scene.history().accepted()
    wrong = [] if end.how == "finished" else [f"resumed, it {end.how}: {end.why}"]
    return wrong if set(accepted) == {1, 2} else [*wrong, f"resumed, poses {sorted(accepted)} are recorded"]


_SOLVED: list[object] = []


def _quick_solution(patch):
    """Solve once for all runs: what is computed is not the matter here."""
    calibrate = bench.batch.rehearsal.calibrate

    def once(views, options):
        if not _SOLVED:
            _SOLVED.append(calibrate(views, options))
        return _SOLVED[0]

    patch.setattr(bench.batch.rehearsal, "calibrate", once)


@contextmanager
def patched():
    with pytest.MonkeyPatch.context() as patch:
        _quick_solution(patch)
        yield patch


def matrix(folder: Path):
    """Every cell: (fault, state) and what became of it."""
    for number, fault in enumerate(FAULTS):
        for state in STATES:
            place = folder / f"{number}-{state}"
            place.mkdir()
            with patched() as patch:
                yield fault, state, strike(fault, state, place, patch)


ENDS = {"failed": "fails safely", "finished": "finishes", "aborted": "aborts safely", "died": "ends at once"}


def text(cells):
    """The document with this matrix as its table."""
    rows: dict[str, dict[str, list[str]]] = {}
    for fault, state, cell in cells:
        row = rows.setdefault(fault.name, {end: [] for end in ENDS})
        if cell.end:
            row[cell.end].append(state)
    lines = ["| fault | " + " | ".join(ENDS.values()) + " |", "| --- " * (len(ENDS) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(map(_named, row.values())) + " |" for name, row in rows.items()]
    return DOCUMENT.read_text().partition("| fault |")[0] + "\n".join(lines) + "\n"


def _named(states):
    return "every state" if len(states) == len(STATES) else ", ".join(states)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        rows = list(matrix(Path(made)))
        for fault, state, cell in rows:
            if cell.wrong:
                print(f"{fault.name} in {state}: {'; '.join(cell.wrong)}", file=sys.stderr)
        DOCUMENT.write_text(text(rows))
