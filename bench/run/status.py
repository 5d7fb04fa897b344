"""Status of a run, read from its folder by another process; the folder is not changed.

The journal and ``plan.json`` give the content; the lock of the folder shows whether a process works on the run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from bench.base.device_ends import NOT_ASKED, all_ends, lost_ends
from bench.base.errors import RunFolderError, StorageError
from bench.base.home import home_folder
from bench.evidence.ledger_authorisation import known_authorisations
from bench.evidence.shown_state import home_trust, shown_state
from bench.records.estimates import estimates, factors_text
from bench.records.folder_lock import is_locked
from bench.records.history import History, replay
from bench.records.journal import read_journal
from bench.records.journal_entry import Entry
from bench.records.reading import read_json
from bench.records.run_folder import JOURNAL, PLAN, is_sealed
from bench.records.way_on import way_on
from bench.report.text import with_uncertainty
from bench.report.until_text import reached_text
from bench.run.interlocks import interlock_text
from bench.run.journal_text import line_text
from bench.run.machine import END_STATES
from bench.run.time_left import TimeLeft

LAST_LINES = 5


@dataclass(frozen=True)
class Status:
    """Status of a run."""

    # run_id, folder, simulated: Name and folder of the run, and whether any device is simulated.
    run_id: str
    folder: str
    simulated: bool
    # running, sealed: Whether a process works on the run, and whether it is finished and sealed.
    running: bool
    sealed: bool
    evidence: str  # ``DRAFT``, ``SEALED`` or ``AUTHORISED``, and who signed, as one line
    # Last state that was entered; if no process works on the run, the state in which it was left.
    state: str
    # ended, why: ``finished``, ``aborted`` or ``failed``, and why; empty while the run has not ended.
    ended: str
    why: str
    # pose, pose_name: Number and name of the pose at work; None and empty between poses.
    pose: int | None
    pose_name: str
    # poses, accepted, skipped, attempts: How many poses there are, how many are recorded, how many are
    # skipped; how many recordings were made. Poses that the run may still choose are not counted.
    poses: int
    most_poses: int  # How many poses there are at most, with those that the run may still choose
    accepted: int
    skipped: int
    attempts: int
    # What an ``until`` has reached, and its goals; empty if the run has decided nothing yet.
    uncertainty: str
    # Focal lengths with their expanded uncertainty, as text; empty if nothing is calibrated yet.
    result: str
    left_s: float | None  # Expected time until the end, s; None if no process works on the run
    held_by: str  # Operator or interlock that holds the run, and why; empty while none does
    question: str  # Question to the operator; empty while there is none
    # resumed, deviations: How often the run was resumed; deviations from the sequence.
    resumed: int
    deviations: Sequence[str]
    # last, advice: Last journal lines as text, the newest last; and what to do next.
    last: Sequence[str]
    advice: str
    # How stage, light and camera were left: ``device``, ``state``, ``said``. Empty while a process works on
    # the run.
    devices: Sequence[Mapping[str, str]] = ()
    # busy, lateness: How late a busy computer was, as text and in seconds (`drivers.lateness`); empty if
    # the journal has none.
    busy: str = ""
    lateness: Mapping[str, Any] = field(default_factory=dict)
    # ledger_number, ledger_head: Number of the run in its bench's ledger, and the hash of its line there;
    # None for a rehearsal.
    ledger_number: int | None = None
    ledger_head: str | None = None

    @property
    def place(self) -> tuple[int, str] | None:
        """Number and hash of the run's line in the ledger; None if it is in no ledger."""
        if self.ledger_number is None or self.ledger_head is None:
            return None
        return self.ledger_number, self.ledger_head

    def to_dict(self) -> dict[str, Any]:
        """Return the status for JSON output."""
        return {"schema": "starbench/status/1", **asdict(self)}


class _Plan(TypedDict):
    """What a status needs of plan.json; the plan of an earlier version has neither ``most_poses`` nor ``untils``."""

    poses: Sequence[Mapping[str, Any]]
    most_poses: NotRequired[int]
    untils: NotRequired[Sequence[Mapping[str, Any]]]
    steps: Sequence[Mapping[str, Any]]
    duration_s: float
    simulated: bool


def read_status(folder: Path, utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> Status:
    """Read the status of a run. Nothing is changed, and its process is not disturbed.

    utc_now: Returns the present time, UTC.
    Raises RunFolderError: If there is no run.
    Raises JournalBroken: If the hash chain of its journal is broken.
    Raises StorageError: If it cannot be read.
    """
    return read_with_entries(folder, utc_now())[0]


def read_with_entries(folder: Path, now: datetime) -> tuple[Status, Sequence[Entry]]:
    """Read the status of a run, and its journal.

    The lock is read first: a run that ends meanwhile does not appear as killed.

    now: The time, UTC.
    Raises RunFolderError: If it is no run folder.
    """
    if not (folder / JOURNAL).is_file():
        raise RunFolderError(
            f"This is not a run folder: it has no {JOURNAL}.",
            where=str(folder),
            remedy="Name the folder of a run.",
        )
    running, sealed = is_locked(folder), is_sealed(folder)
    entries, _ = read_journal(folder / JOURNAL)
    return _status(folder, entries, now, running=running, sealed=sealed), entries


def _status(folder: Path, entries: Sequence[Entry], now: datetime, *, running: bool, sealed: bool) -> Status:
    history, plan = replay(entries), _plan_of(folder)
    names = {pose["index"]: pose["name"] for pose in plan["poses"]}
    names |= {d["chosen"]["pose"]: d["chosen"]["pose_name"] for d in history.decisions if "chosen" in d}
    held_by = _held_by(history) if running else ""
    going_on = running and not _is_over(history)
    return Status(
        run_id=str(history.started.get("id", folder.name)),
        folder=str(folder),
        simulated=bool(history.started.get("simulated", plan["simulated"])),
        running=running,
        sealed=sealed,
        evidence=shown_state(
            folder, home_trust(home_folder()), now, known_authorisations(home_folder())
        ).text,
        state=history.states[-1]["state"] if history.states else "idle",
        ended=history.ended,
        why=history.why,
        pose=history.at_pose,
        pose_name=names.get(history.at_pose or 0, ""),
        poses=len(names),
        most_poses=_most_poses(plan, history, len(names)),
        accepted=len(history.accepted()),
        skipped=len(history.skipped),
        attempts=len(history.attempts) + sum(history.lost.values()),
        uncertainty=reached_text(history.decisions[-1]) if history.decisions else "",
        result=_result_text(history),
        left_s=_left_s(history, plan, entries, now) if going_on else None,
        held_by=held_by,
        question=history.question if running else "",
        resumed=history.resumed,
        deviations=tuple(history.deviations),
        last=_last_lines(entries),
        advice=_advice(folder, history, running=running, sealed=sealed),
        devices=() if going_on else _devices_left(history),
        busy=history.busy,
        lateness=history.lateness,
        ledger_number=history.ledger.get("number"),
        ledger_head=history.ledger.get("head"),
    )


def _devices_left(history: History) -> tuple[Mapping[str, str], ...]:
    """Return how each device was left, by the last line that states it; a process that was killed states nothing."""
    stated = history.devices_at_end or history.devices_left
    if stated or history.ended:
        return tuple(stated)
    ends = lost_ends(NOT_ASKED) if history.states else all_ends(())
    return tuple(end.to_dict() for end in ends)


def _result_text(history: History) -> str:
    """Return fx and fy with their expanded uncertainties; empty without a calibration that converged."""
    solved = history.solved
    if not solved or not solved["converged"]:
        return ""
    found = {name: one for name, one in estimates(solved).items() if name in {"fx", "fy"}}
    parts = [
        "{} {} ± {} px".format(name, *with_uncertainty(one.value, one.expanded))
        for name, one in found.items()
    ]
    return f"{', '.join(parts)} ({factors_text(one.k for one in found.values())})" if parts else ""


def _most_poses(plan: _Plan, history: History, known: int) -> int:
    """Return how many poses there can be; that is known once every ``until`` has ended."""
    ended = {decided["until"] for decided in history.decisions if "ended" in decided}
    if all(until["first"] in ended for until in plan.get("untils", ())):
        return known
    return max(known, plan.get("most_poses", known))


def _plan_of(folder: Path) -> _Plan:
    try:
        plan: dict[str, Any] = read_json(folder / PLAN)
        found = _Plan(**{name: plan[name] for name in _Plan.__required_keys__})  # type: ignore[typeddict-item]
        if "untils" in plan:
            found["most_poses"], found["untils"] = int(plan["most_poses"]), plan["untils"]
    except (StorageError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"{PLAN} cannot be read.",
            where=str(folder),
            remedy="The file is damaged or was written by another program.",
        ) from error
    return found


def _left_s(history: History, plan: _Plan, entries: Sequence[Entry], now: datetime) -> float:
    """Return the time left by plan and pace; a held run has its whole rest before it."""
    left = TimeLeft(plan["steps"], plan["duration_s"])
    for entry in entries:
        left.apply(entry, history)
    return round(left.left_s(now, held=bool(history.holder)), 1)


def _held_by(history: History) -> str:
    if history.interlock:
        name, _, why = history.interlock.partition(":")
        return f"the {interlock_text(name)} interlock:{why}"
    return history.holder


def _advice(folder: Path, history: History, *, running: bool, sealed: bool) -> str:
    if running and not sealed:
        return _advice_while_running(folder, history)
    if sealed:
        return f"Finished and sealed. To check the seal: starbench verify {folder}"
    if history.ended == "finished":
        return f"The run has finished, but it is not sealed. To seal it: starbench resume {folder}"
    return "No process works on this run. {} {}".format(*way_on(history, folder))


def _advice_while_running(folder: Path, history: History) -> str:
    if _is_over(history):
        return "No action is needed: the run has ended, and its process is about to end."
    if history.interlock:
        return (
            "No action is needed: the run continues by itself when this is over, or ends safely if it holds for too"
            " long."
        )
    if history.question:
        return f"The run asks: {history.question} To answer: starbench tell {folder} yes (or no)"
    if history.holder:
        return f"Held by {history.holder}. To continue: starbench tell {folder} release"
    return f"No action is needed. To stop the run safely: starbench tell {folder} abort"


def _is_over(history: History) -> bool:
    """Return whether nothing of the run is left to do but to seal it."""
    return bool(history.ended) or (bool(history.states) and history.states[-1]["state"] in END_STATES)


def _last_lines(entries: Sequence[Entry]) -> tuple[str, ...]:
    texts = (text for text in map(line_text, reversed(entries)) if text)
    return tuple(reversed(tuple(islice(texts, LAST_LINES))))
