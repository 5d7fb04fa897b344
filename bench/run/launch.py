"""Begin a run, or resume one: check files, create and lock the folder, begin the journal, run, seal the result.

All faults of the files are found before the folder is created, all faults of the folder before a device is opened.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from bench.base.clock import BenchClock, stop_on_signals
from bench.base.compiled_loops import SIMULATOR, STARS, compile_loops
from bench.base.errors import RunFolderError, UsageError
from bench.base.home import home_folder
from bench.base.progress import Progress
from bench.evidence.keys import BenchKey, key_to_seal, usable_key
from bench.evidence.seal import seal
from bench.plan.departures import departures
from bench.plan.job import Job, documents_of
from bench.plan.plan import Plan
from bench.record.events import Event
from bench.record.history import History, replay
from bench.record.journal import Journal
from bench.record.journal_line import Entry
from bench.record.pace import pace_on
from bench.record.recovery import WIRE_LOG, gone_captures
from bench.record.run_folder import REPORT, RunFolder, require_resumable
from bench.record.storage import sha256_of, storage_errors
from bench.record.stored_run import StoredRun
from bench.run.control import remove_inbox
from bench.run.crash_log import archive_crash, crash_log, read_crash
from bench.run.ended_page import remove_ended_page, write_ended_page
from bench.run.ledger_entry import (
    enter_in_ledger,
    ledger_entry,
    ledger_lines,
    ledger_of,
    refuse_broken_ledger,
)
from bench.run.messages.run_messages import RunMessages
from bench.run.runner import RunEnd, Runner
from bench.run.steps_to_do import intentions
from bench.solve.result import Outcome
from bench.solve.software import plugins_of_run, run_software
from bench.stations.cameras import PictureFolderConfig
from bench.stations.devices import Devices
from bench.wording.conformity import conformity_headline
from drivers.wire_log import WireLogFile
from sequences.reader import OptionSettings

AskPassphrase = Callable[[Path], bytes]
_SERIAL = "station.camera.serial"


@dataclass(frozen=True)
class Launch:
    """What the caller provides, to begin a run or to resume one."""

    clock: BenchClock
    stream: TextIO | None = None  # Stream for progress; standard error by default
    ask_passphrase: AskPassphrase | None = None  # Asks for the passphrase of a protected signing key


def serial_number(scanned: str) -> str:
    """Return the serial number in the text of a scanner: without the spaces and the end of line around it."""
    serial = scanned.strip()
    if not serial or len(serial) > 64 or not serial.isprintable():
        raise UsageError(
            f"{serial[:64]!r} is no serial number." if serial else "No serial number was scanned.",
            where="--expect-serial",
            remedy="Scan the code on the camera again.",
        )
    return serial


def _expecting(serial: str, settings: Mapping[str, str]) -> Mapping[str, str]:
    """Return settings with the serial number that the camera must have."""
    if _SERIAL in settings:
        raise UsageError(
            f"--expect-serial cannot be used with --set {_SERIAL}.", remedy="Leave one of them out."
        )
    text = json.dumps(serial_number(serial), ensure_ascii=False)
    return OptionSettings({**settings, _SERIAL: text}, "--expect-serial")


def _require_own_serial(job: Job) -> None:
    if isinstance(job.station.camera, PictureFolderConfig):
        raise UsageError(
            "A folder of pictures does not state which camera took them, so no serial number can be expected.",
            where="--expect-serial",
            remedy="Leave the option out.",
        )


def start_run(
    sequence: str,
    station: str,
    *,
    output: Path | None,
    seed: int | None,
    operator: str | None,
    launch: Launch,
    settings: Mapping[str, str] | None = None,
    expect_serial: str | None = None,
) -> RunEnd:
    """Run a sequence on a station, from the plan to the sealed report.

    ``output`` None is a new folder in ``runs/``; ``seed`` None is drawn and recorded; ``settings`` replace those of the
    files (`load_documents`), also in the copies; ``expect_serial`` replaces the station's.
    """
    given = settings or {}
    if expect_serial is not None:
        settings = _expecting(expect_serial, given)
    seed = secrets.randbits(31) if seed is None else seed
    job = Job.from_files(sequence, station, seed=seed, operator=operator, settings=settings)
    if expect_serial is not None:
        _require_own_serial(job)
    plan = job.plan
    ledger = ledger_of(launch.clock)
    refuse_broken_ledger(ledger, job)
    pace = pace_on(plan.station.value.name).factor
    key = _key(launch)
    folder_path = output or default_folder(plan, launch.clock.utc_now())
    kept_free = int(plan.station.value.disk.min_free_gb * 1e9)
    written = documents_of(plan)
    with RunFolder.create(
        folder_path, bytes_needed=plan.size_bytes, bytes_kept_free=kept_free, documents=written
    ) as folder:
        _compile_loops_for(job)
        for name, text in written.items():
            folder.write_atomic(name, text)
        place = enter_in_ledger(ledger, job, folder.path)
        with (
            ledger_entry(ledger, place, folder.path) as ending,
            Journal.create(folder.journal_path, launch.clock) as journal,
        ):
            journal.append(
                Event.RUN_STARTED,
                id=folder_path.resolve().name,
                sequence=plan.sequence.value.name,
                station=plan.station.value.name,
                sha256={name: hashlib.sha256(text).hexdigest() for name, text in written.items()},
                seed=seed,
                operator=job.operator,
                simulated=job.simulated,
                software=run_software(job.station),
                begun_with=_begun_with(sequence, station, settings or {}),
                **plugins_of_run(job.station),
                **({"pace": round(pace, 2)} if pace > 1.0 else {}),
                ledger=place,
            )
            for what in departures(job, given):
                journal.append(Event.DEVIATION, what=what)
            return ending(run_and_seal(job, folder, journal, launch, key, ledger_lines(place)))


def _begun_with(sequence: str, station: str, settings: Mapping[str, str]) -> list[str]:
    """Return the arguments that begin a run again from any folder: files as absolute paths, names as they are."""
    files = [str(Path(file).resolve()) if Path(file).is_file() else file for file in (sequence, station)]
    changed = [word for name, value in settings.items() for word in ("--set", f"{name}={value}")]
    return [files[0], "--station", files[1], *changed]


def resume_run(folder_path: Path, launch: Launch) -> RunEnd:
    """Continue a run that was aborted, failed, was killed or lost power; first print what will be done.

    Stored recordings are kept; the step at which it stopped is repeated, after the move that it depends on.
    """
    with RunFolder.open(folder_path) as folder, Journal.open(folder.journal_path, launch.clock) as journal:
        job, history = job_of(folder.path, journal.entries)
        crash = read_crash(folder.path)
        key = _key(launch)
        ledger = ledger_of(launch.clock)
        place = enter_in_ledger(ledger, job, folder.path, history.ledger)
        with ledger_entry(ledger, place, folder.path) as ending:
            if history.ended == "finished":
                archive_crash(folder)
                return ending(seal_finished(folder, journal, key))
            _compile_loops_for(job)
            extra: dict[str, Any] = {"crash": crash} if crash else {}
            extra |= {"ledger": place} if place != history.ledger else {}
            journal.append(
                Event.RUN_RESUMED, torn_bytes=len(journal.torn), software=run_software(job.station), **extra
            )
            remove_ended_page(folder)
            # After the journal: a process that dies in between neither loses the crash nor counts it twice.
            archive_crash(folder)
            lines = [
                *ledger_lines(place),
                *intentions(job, history, crash, gone_captures(folder.path, journal.entries)),
            ]
            return ending(run_and_seal(job, folder, journal, launch, key, lines))


def _compile_loops_for(job: Job) -> None:
    """Compile what the run will use, before it opens a device, whose answers do not wait."""
    compile_loops(STARS, *((SIMULATOR,) if job.station.needs_simulated_bench else ()))


def read_intentions(folder_path: Path) -> list[str]:
    """Return what resuming a run would do. Nothing is changed."""
    require_resumable(folder_path)
    entries = StoredRun(folder_path).entries
    job, history = job_of(folder_path, entries)
    return intentions(job, history, read_crash(folder_path), gone_captures(folder_path, entries))


def job_of(folder: Path, entries: Iterable[Entry]) -> tuple[Job, History]:
    """Return the task of a run, from the files that it was begun with, and its history."""
    history = replay(entries)
    never = "" if history.started else "This run was interrupted before it began."
    if history.started.get("rehearsal"):
        never = "This run is a rehearsal without devices; it cannot be resumed."
    if never:
        raise RunFolderError(never, where=str(folder), remedy="Start a new run.")
    _refuse_changed(folder, history.started["sha256"])
    job = Job.from_run_folder(folder, seed=history.started["seed"], operator=history.started["operator"])
    return job, history


def default_folder(plan: Plan, now: datetime) -> Path:
    """Return the default folder of a run, named by time and sequence, below ``runs/``."""
    ascii_name = "".join(c if c.isalnum() and c.isascii() else "-" for c in plan.sequence.value.name.lower())
    name = "-".join(filter(None, ascii_name.split("-")))[:40] or "run"
    return Path("runs") / f"{now:%Y%m%d-%H%M%S}-{name}"


def run_and_seal(
    job: Job, folder: RunFolder, journal: Journal, launch: Launch, key: BenchKey, first_lines: Iterable[str]
) -> RunEnd:
    """Do the work of a run, and seal its folder if it finished."""
    clock = launch.clock
    wire_log = WireLogFile(folder.path / WIRE_LOG)
    progress = Progress(job.plan.duration_s, stream=launch.stream)

    def open_devices() -> Devices:
        return Devices(job.station, seed=job.seed, clock=clock, wire_log=wire_log)

    with progress, stop_on_signals(clock.request_stop):
        if key.created:
            progress.say(f"Created a signing key for this bench: {key.fingerprint}; see `starbench keys`.")
        for line in first_lines:
            progress.say(line)
        messages = RunMessages(job.station.messages, folder.path, clock, progress.say)

        try:
            try:
                with crash_log(folder.path):
                    end = Runner(
                        job, folder, journal, open_devices, clock, progress, messages.write, wire_log
                    ).run()
            finally:
                wire_log.close()
            sealing_key = partial(key_to_seal, home_folder(), key, clock.utc_now(), launch.ask_passphrase)
            if end.how == "finished":
                journal.close()
                seal(folder, sealing_key())
            else:
                write_ended_page(folder, sealing_key, progress.say, job.target)
            what = f"{end.how}{_passed(end)}{': ' if end.why else ''}{end.why}{_devices_left(end)}"
            messages.write("failure" if end.how == "failed" else "end", what, journal.head)
        except BaseException as error:
            messages.write("failure", f"failed: {type(error).__name__}: {error}", journal.head)
            raise
        finally:
            messages.close()
    return end


def _passed(end: RunEnd) -> str:
    """Return PASS or FAIL by the limits, for a message; empty for a run without limits."""
    conformity = end.outcome.results.get("conformity") if end.outcome else None
    return f", {conformity_headline(conformity)}" if conformity else ""


def _devices_left(end: RunEnd) -> str:
    """Return how the devices were left, for a message; empty if all confirmed a safe state, or no step used any."""
    if end.how == "finished" and not end.opened:
        return ""
    unsure = [device.text for device in end.devices if device.state != "confirmed safe"]
    return "".join(f" {text}" for text in unsure)


def _key(launch: Launch) -> BenchKey:
    """Return the bench's key: before the folder of a run is made, because without a key it could not be sealed."""
    return usable_key(home_folder(), launch.clock.utc_now(), ask_passphrase=launch.ask_passphrase)


def seal_finished(folder: RunFolder, journal: Journal, key: BenchKey) -> RunEnd:
    """Seal a run that was interrupted between its last journal line and its seal."""
    journal.close()
    remove_inbox(folder.path)
    run = StoredRun(folder.path)  # without results if its sequence ends without a report
    outcome = Outcome(run.results, folder.path / REPORT) if run.has_results else None
    seal(folder, key)
    return RunEnd("finished", "", folder.path, outcome)


def _refuse_changed(folder: Path, hashes: Mapping[str, str]) -> None:
    for name, sha256 in hashes.items():
        with storage_errors(folder / name):
            is_same = sha256_of(folder / name) == sha256
        if not is_same:
            raise RunFolderError(
                f"{name} was changed after this run began.",
                where=str(folder),
                remedy="Restore the original file, or start a new run with the changed file.",
            )
