"""Makes results again from their sources, and compares the trees: `verify --again` of a sealed folder.

A run: its own writer makes results, views, exports, report and plan again from the recordings; the journal is compared,
too. Recalculated results: they are calibrated again from their sources; where a source has gone, or is another file
now, it says that the numbers were not compared. Nothing is written.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, cast

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError, RunFolderError, StorageError
from bench.evidence.findings import UNREADABLE, Findings
from bench.evidence.sshsig import fingerprint, read_signature
from bench.measure.measure import Measurement
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Event
from bench.record.history import Attempt, History, replay
from bench.record.journal import Entry
from bench.record.results import PreviousData
from bench.record.run_folder import (
    JOURNAL,
    PASSPORT_COPY,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    SIGNATURE,
    STATION_COPY,
    WIRE_LOG,
)
from bench.record.storage import read_bounded, read_json, sha256_of
from bench.record.stored_run import StoredRun
from bench.solve.compare_numbers import MOST_SHOWN, add_faults, differences, is_excused, tolerance
from bench.solve.compare_trees import (
    MadeAgain,
    compare_file,
    compare_instructions,
    compare_plan,
    compare_trees,
)
from bench.solve.offline import OfflineResult, calibrate_paths
from bench.solve.offline_folder import SOURCES, SealedBy, offline_files, source_data
from bench.solve.offline_options import StationFile, options_of_data, passport_of_file
from bench.solve.result import change_since
from bench.solve.results_content import (
    other_engine,
    other_software,
    plugins_missing,
    plugins_of_run,
    plugins_stated,
    results_content,
    software,
)
from bench.solve.solution import main_numbers, solve_run
from bench.stations.station import load_station
from calib.errors import CalibrationError
from calib.target import StarTarget
from drivers.errors import DriverError
from sequences.errors import SequencesError
from sequences.script import RecordStep, SolveStep

_WITH_STAGE = frozenset({"homing", "slewing", "parking"})
"""States in which the program speaks to the stage."""
_SLACK_S = 1e-3
_MOST_LOG_BYTES = 64 << 20
"""Logs are rotated at 8 MB."""


def check_wire_log(folder: Path, entries: Sequence[Entry], job: Job, found: Findings) -> None:
    """Check that the wire log, about the last 32 MB, holds bytes at each journaled move, and the stage's serials."""
    moves = list(_moves(entries))
    try:
        times, replies, ports = _read_logs(folder)
    except (StorageError, ValueError, LookupError, TypeError) as error:
        found.fault("wire", WIRE_LOG, f"the wire log cannot be read ({error!r})")
        return
    if moves and not times:
        found.fault("wire", WIRE_LOG, "it holds no bytes, though the journal tells of moves of the stage")
        return
    for begin_s, end_s, entry in moves:
        if begin_s < times[0]:  # older bytes are not kept
            continue
        at = bisect_left(times, begin_s - _SLACK_S)
        if at == len(times) or times[at] > end_s + _SLACK_S:
            what = f"it holds no bytes of the time in which the journal tells of {entry.data['state']}"
            found.fault("wire", WIRE_LOG, f"{what} ({JOURNAL}:{entry.seq + 1})")
            return
    station = job.station
    stated = {*station.stage.ports, *station.light.ports}
    if times and not station.needs_simulated_bench and not ports & stated:
        what = f"its ports {sorted(ports)} are not those of the station, {sorted(stated)}"
        found.fault("wire", WIRE_LOG, what)
    _check_serials(entries, job, replies, found)


def _moves(entries: Sequence[Entry]) -> Iterator[tuple[float, float, Entry]]:
    """Yield begin and end of each move, monotonic time in s, with its line."""
    begun: Entry | None = None
    for entry in entries:
        if entry.event == Event.ENTERING:
            begun = entry if entry.data.get("state") in _WITH_STAGE else None
        elif entry.event == Event.LEFT_OFF and begun is not None:
            if "error" not in entry.data and entry.data.get("state") == begun.data["state"]:
                yield begun.mono_s, entry.mono_s, begun
            begun = None


def _read_logs(folder: Path) -> tuple[list[float], str, set[str]]:
    """Return the sorted times of all bytes, s, all bytes of devices, and the ports. Raises StorageError, ValueError."""
    times: list[float] = []
    replies: list[str] = []
    ports: set[str] = set()
    for path in sorted(folder.glob(f"{WIRE_LOG}*")):
        for line in read_bounded(path, _MOST_LOG_BYTES).splitlines():
            record: dict[str, Any] = parse_json(line.decode("ascii", "replace"))
            times.append(float(record["t"]))
            ports.add(str(record["port"]))
            if record["dir"] == "<":
                replies.append(str(record["bytes"]))
    return sorted(times), "".join(replies), ports


def _check_serials(entries: Sequence[Entry], job: Job, replies: str, found: Findings) -> None:
    """Compare the serial numbers of stage and light with the replies of devices that speak in text."""
    station = job.station
    in_text = {"stage": station.stage.driver == "zaber_ascii", "light": station.light.driver == "scpi"}
    for entry in entries:
        if entry.event != Event.DEVICES:
            continue
        for part in (part for part, is_text in in_text.items() if is_text):
            told = entry.data.get(part) or []
            for identity in told if isinstance(told, list) else [told]:
                serial = str(identity.get("serial") or "")
                if serial and serial not in replies:
                    what = (
                        f"no device told the serial number {serial}, which the journal states for the {part}"
                    )
                    found.fault("wire", WIRE_LOG, f"{what} ({JOURNAL}:{entry.seq + 1})")


@dataclass(frozen=True)
class _Evidence:
    """What a run folder holds, as read for the checks."""

    folder: Path
    entries: Sequence[Entry]
    job: Job
    # History of the run up to the moment when its results were made; of the whole run if it has none.
    history: History
    head: str  # Hash of the journal's line that the report prints; empty if the run has no results

    @property
    def used(self) -> dict[str, Any]:
        """Software of the process that made the results, as the journal states it."""
        begun: dict[str, Any] = {}
        for entry in self.entries:
            if entry.event in {Event.RUN_STARTED, Event.RUN_RESUMED}:
                begun = dict(entry.data.get("software", {}))
            if entry.hash == self.head:
                break
        return begun

    @property
    def solve_step(self) -> SolveStep | None:
        """The solve step whose calibration the results state."""
        done = self.history.done_steps
        return next(
            (s for s in reversed(self.job.steps) if isinstance(s, SolveStep) and s.number in done), None
        )


def check_run_again(folder: Path) -> Findings:
    """Make the results of a run again from its recordings, and compare every file with what follows from them."""
    found = Findings()
    evidence = _read(folder, found)
    if evidence is None:
        return found
    started = evidence.history.started
    compare_instructions(folder, started.get("software", {}), found)
    found.remarks += [
        f"the {drivers} was driven by a plug-in: {package}"
        for package, drivers in plugins_stated(started).items()
    ]
    _check_first_line(evidence, found)
    compare_plan(folder, evidence.job.plan.to_dict(), started.get("software", {}), found)
    _check_steps(evidence, found)
    check_wire_log(folder, evidence.entries, evidence.job, found)
    measured = _check_attempts(evidence, found)
    if not evidence.head:
        found.remarks.append("this run has no results to calculate again")
        return found
    if other := other_software(evidence.used):
        found.remarks.append(f"the results were made with {other}")
    try:
        why = other_engine(StoredRun(folder).results_as_written)
    except RunFolderError as error:
        found.fault("results", RESULTS, error.what.rstrip("."))
        return found
    if why:
        found.could_not_compare(f"{RESULTS}, exports and {REPORT}: {why}", "results", "exports", "report")
    elif (made := _made_again(evidence, measured, found)) is not None:
        compare_trees(folder, made, found)
    return found


def _read(folder: Path, found: Findings) -> _Evidence | None:
    """Read journal and documents of a run; None if a part cannot be read, which ``found`` then tells."""
    run = StoredRun(folder)
    entries, whole = run.entries, run.history
    try:
        job = _job(folder, whole)
    except (BenchError, DriverError, CalibrationError, *UNREADABLE) as error:
        used = whole.started.get("software", {})
        if missing := plugins_missing(whole.started):
            found.could_not_compare(
                f"{RESULTS}, exports and {REPORT}: the station needs {', '.join(missing)}, which this computer does"
                " not have; install it and verify again",
                "results",
                "exports",
                "report",
            )
        elif used.get("program") == software()["program"]:
            found.fault("plan", STATION_COPY, f"the run cannot be planned again from its documents: {error}")
        else:
            found.could_not_compare(
                f"{RESULTS}, exports and {REPORT}: this version cannot read the documents of the run ({error})",
                "results",
                "exports",
                "report",
            )
        return None
    if not (folder / RESULTS).is_file():
        return _Evidence(folder, entries, job, whole, "")
    head = _head(entries)
    at = next((number for number, entry in enumerate(entries, start=1) if entry.hash == head), None)
    if at is None:
        found.fault("report", REPORT, "the report names no line of this journal")
        return None
    return _Evidence(folder, entries, job, replay(entries[:at]), head)


def _job(folder: Path, history: History) -> Job:
    """Plan the run again, as of its day: a passport may have expired since. Raises ScriptError."""
    documents = load_documents(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY))
    day = datetime.fromisoformat(history.started_utc).date()
    planned = make_plan(*documents, passport_copy=folder / PASSPORT_COPY, today=day)
    if planned.faults:
        raise ValueError("; ".join(str(fault) for fault in planned.faults))
    return Job.from_plan(planned, seed=history.started["seed"], operator=history.started["operator"])


def _head(entries: Sequence[Entry]) -> str:
    """Return the hash of the journal's line that the report prints, as the journal states it; empty if it does not."""
    return next(
        (str(entry.data.get("head")) for entry in reversed(entries) if entry.event == Event.WRITTEN), ""
    )


def _check_first_line(evidence: _Evidence, found: Findings) -> None:
    """Compare what the journal's first line repeats of the documents."""
    job, started = evidence.job, evidence.history.started
    due = {
        "sequence": job.plan.sequence.value.name,
        "station": job.plan.station.value.name,
        "simulated": job.simulated,
        **({"plugins": plugins_of_run(job.station).get("plugins")} if started.get("plugins") else {}),
    }
    for one in differences({name: started.get(name) for name in due}, due):
        found.fault("journal", f"{JOURNAL}:1", f"{one}, by the run's documents")


def _check_steps(evidence: _Evidence, found: Findings) -> None:
    """Check that the run did every step of its sequence; else it has not finished, or lines were removed."""
    history = replay(evidence.entries)
    recorded = history.accepted()
    for step in evidence.job.steps:
        if step.number not in history.done_steps and not history.is_left_out(step.number):
            found.fault(
                "journal", JOURNAL, f"it does not tell that step {step.number} of the sequence was done"
            )
            return
        is_left_out = history.is_left_out(step.number)
        if isinstance(step, RecordStep) and not is_left_out and step.pose.index not in recorded:
            told = history.attempts_at(step.pose.index) or history.lost.get(step.pose.index)
            if not told and step.pose.index not in history.skipped:
                what = f"it tells of no recording at pose {step.pose.index}, and of no reason"
                found.fault("journal", JOURNAL, what)


def _check_attempts(evidence: _Evidence, found: Findings) -> dict[int, Measurement]:
    """Measure every recording again and compare with the journal; return the measurements of the accepted ones."""
    kept: dict[int, Measurement] = {}
    other = other_software(evidence.history.started.get("software", {}))
    for attempt in evidence.history.attempts:
        name = str(attempt.stored["capture"])
        if not (evidence.folder / name).is_file():
            found.remarks.append(f"{name} was lost before the run was resumed, so it was not measured again")
            continue
        again = evidence.job.measure_again(evidence.folder, attempt)
        if attempt.accepted and again.view is not None:
            kept[attempt.pose_index] = again
        if attempt.checked is None:
            continue
        due = _judged(evidence.job, attempt, again)
        had = {name: attempt.checked.get(name) for name in due}
        where = f"pose {attempt.pose_index} attempt {attempt.attempt}"
        seen = list(differences(had, due, tolerance({}, {}), where))
        if other and had["accepted"] == due["accepted"]:
            seen = [one for one in seen if not (is_excused(one, {}) or ".reasons[" in one.where)]
        for one in seen[:MOST_SHOWN]:
            found.fault("journal", JOURNAL, f"the recordings do not give what it states: {one}")
    return kept


def _judged(job: Job, attempt: Attempt, again: Measurement) -> dict[str, Any]:
    """Return what the journal must hold about a recording; of the expected grid, which is not known, what it states."""
    judged = job.judged(job.record_step(attempt.pose_index), attempt.stored, again)
    facts = {name: value for name, value in again.facts.items() if name != "expected_grid"}
    stated = attempt.measured.get("expected_grid")
    return {**judged, "measured": {**facts, **({"expected_grid": stated} if stated is not None else {})}}


def _made_again(evidence: _Evidence, measured: dict[int, Measurement], found: Findings) -> MadeAgain | None:
    """Calibrate again, as the run did; None if that fails, which ``found`` then tells."""
    job, history, step = evidence.job, evidence.history, evidence.solve_step
    if step is None:
        found.fault("results", RESULTS, "the journal tells of no solve step")
        return None
    try:
        solution = solve_run(job, evidence.folder, step, history, measured)
        results = results_content(job, history, solution, job.read_truth(), evidence.used)
        stored = StoredRun(evidence.folder).results_as_written.get("previous")
        if stored is not None and evidence.history.ledger:
            results["previous"] = cast("PreviousData", _previous_again(stored, results))
    except (BenchError, CalibrationError, DriverError) as error:
        found.fault("results", RESULTS, f"the run cannot be calibrated again: {error}")
        return None
    except UNREADABLE as error:
        found.fault("results", RESULTS, f"the results have no calibration to compare ({error!r})")
        return None
    _check_solved(evidence, solution.calibration.sigma, main_numbers(solution.calibration), found)
    return MadeAgain(results, solution.views, job.camera_name, job.target, evidence.used, evidence.head)


def _previous_again(stored: Mapping[str, Any], results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the comparison with the earlier run that the results name; its folder may have gone."""
    if stored.get("run") is None:
        return dict(stored)
    return {**stored, "change": change_since(stored["calibration"], results["calibration"])}


def _check_solved(
    evidence: _Evidence, sigma: Mapping[str, float], again: Mapping[str, Any], found: Findings
) -> None:
    """Compare the main numbers of the calibration in the journal with those that were calculated again."""
    solved = evidence.history.solved
    had, must = (
        {"calibration": {**one, "camera": one.get("values"), "values": None}} for one in (solved, again)
    )
    seen = list(differences(had, must, tolerance(sigma, {})))
    if other_software(evidence.used):
        seen = [one for one in seen if not is_excused(one, sigma)]
    add_faults("journal", JOURNAL, "the recordings do not give what it states: ", seen, found)


# Recalculated results: the sources are calibrated again.


def check_recalculated(folder: Path) -> Findings:
    """Calibrate the sources of recalculated results again, with the same options, and compare every file."""
    found = Findings()
    try:
        described, stored = read_json(folder / SOURCES), StoredRun(folder).results_as_written
        used = stored["run"]["software"]
        compare_instructions(folder, used, found)
        _check_station(described, found)
        if stored["sources"] != described["sources"]:
            found.fault("results", RESULTS, f"its sources are not those of {SOURCES}")
            return found
        if why := other_engine(stored) or _cannot(described):
            found.could_not_compare(f"{RESULTS} with its sources: {why}", "results")
            return found
        again = _calibrated(folder, described)
        pairs = zip(again.sources, again.views, strict=True)
        sources = [source_data(source, view.name) for source, view in pairs]
        if sources != described["sources"]:
            found.could_not_compare(
                f"{RESULTS} with its sources: the paths hold other files now than those that were calculated from",
                "results",
            )
            return found
        files = offline_files(again, str(stored["run"]["id"]), _sealer(folder, stored), sources=sources)
        results = parse_json(files[RESULTS])
        results["run"] |= {name: stored["run"][name] for name in ("calibrated_utc", "software")}
    except (BenchError, CalibrationError, DriverError) as error:
        found.fault("results", RESULTS, f"its sources cannot be calibrated again: {error}")
        return found
    except (StorageError, *UNREADABLE) as error:
        found.fault("results", RESULTS, f"it cannot be compared with its sources ({error!r})")
        return found
    for name in (SOURCES, PASSPORT_COPY):
        compare_file(
            folder / name, name, files.get(name), "results", other_software(used), found, "the sources"
        )
    made = MadeAgain(
        results,
        again.stored_views,
        str(described["camera_name"]),
        again.board or again.target,
        used,
        source="sources",
    )
    compare_trees(folder, made, found)
    return found


def _check_station(described: Mapping[str, Any], found: Findings) -> None:
    """Compare the station file of the command line, if it is still there, with its hash and its target."""
    stated = described["station"]
    if stated is None:
        return
    path = Path(str(stated["path"]))
    if not path.is_file():
        found.remarks.append(f"the station file {path}, whose target was used, is not there any more")
        return
    if sha256_of(path) != stated["sha256"]:
        found.remarks.append(
            f"{path}: another station file lies there now than the one whose target was used"
        )
        return
    try:
        target = asdict(load_station(str(path)).value.target.pattern())
    except (BenchError, SequencesError) as error:
        found.remarks.append(f"the target of the station file {path} cannot be read here: {error}")
        return
    for one in differences(described["option_target"], target):
        found.fault("results", SOURCES, f"option_target: {one}, by the station file {path}")


def _sealer(folder: Path, stored: Mapping[str, Any]) -> SealedBy | None:
    """Return who sealed the results, by the key of their signature; None if they name nobody. Raises ``UNREADABLE``."""
    stated = stored["run"].get("sealed_by")
    if stated is None:
        return None
    key = read_signature((folder / SIGNATURE).read_bytes()).public_key
    return SealedBy(str(stated["principal"]), fingerprint(key))


def _cannot(described: Mapping[str, Any]) -> str:
    """Return why the calibration cannot be made again; empty if it can."""
    gone = [path for path in described["paths"] if not Path(path).exists()]
    if gone:
        return f"{gone[0]} is not there any more" + (f", and {len(gone) - 1} more" if len(gone) > 1 else "")
    for source in described["sources"]:
        path = Path(str(source["path"]))
        if not path.is_file():
            return f"{path} is not there any more"
        if sha256_of(path) != source["sha256"]:
            return f"{path} is another file now"
    return ""


def _calibrated(folder: Path, described: Mapping[str, Any]) -> OfflineResult:
    """Calibrate the sources again. Raises the errors of the reader and of the engine, and one of ``UNREADABLE``."""
    stored, passport = described["options"], None
    if stored["passport"] is not None:
        passport = passport_of_file(folder / PASSPORT_COPY, str(stored["passport"]))
    given = described["option_target"]
    target = StarTarget(**{**given, "tag_square": tuple(given["tag_square"])})
    station = described["station"]
    options = replace(
        options_of_data(stored, passport, target), station=None if station is None else StationFile(**station)
    )
    return calibrate_paths([Path(path) for path in described["paths"]], options)
