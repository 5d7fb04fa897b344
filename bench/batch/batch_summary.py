"""Summary of a batch: every run, the reasons of failures, and the trend of each camera's parameters.

Made from the batch's journal and those of its runs, as ``summary.json`` and ``summary.html``, again at any time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path

from bench.base.bounded_json import canonical_json
from bench.base.errors import BenchError, RunFolderError
from bench.base.pasteable import pasteable
from bench.batch.batch_record import BatchRecord, Requested, RunState, by_priority, replay_batch
from bench.charts.chart_findings import find_charts, needs_attention
from bench.charts.chart_groups import group_runs
from bench.record.coverage import REPEATS_TEXT, factors_text, parameters_data
from bench.record.folder_lock import is_locked
from bench.record.journal import read_journal
from bench.record.run_facts import IndexedRun, RunDetails, RunPlace
from bench.record.run_folder import JOURNAL, REPORT
from bench.record.run_index import QUEUE_COPY, read_run_and_details, require_batch
from bench.record.storage import write_atomic
from bench.record.stored_run import StoredRun
from bench.record.summaries import (
    IN_PROGRESS,
    BatchSummary,
    CameraData,
    ItemData,
    RequestData,
    TotalsData,
)
from bench.report.batch_page import render_batch
from bench.run.status import read_plan
from bench.solve.agreement import agreements, by_camera
from bench.wording.causes import cause_sentences
from bench.wording.goals import goals_missed
from bench.wording.numbers import with_uncertainty
from bench.wording.parameters import unit_text
from sequences.errors import DocumentFaults
from sequences.queue import Queue
from sequences.reader import read_document

RUNS = "runs"
SUMMARY, PAGE = "summary.json", "summary.html"
SCHEMA = "starbench/batch/1"


def read_batch(folder: Path) -> BatchRecord:
    """Read the state of a batch from its folder; changes nothing and disturbs no process."""
    require_batch(folder)
    try:
        queue = read_document(folder / QUEUE_COPY, Queue).value
    except DocumentFaults as error:
        raise RunFolderError(
            f"{QUEUE_COPY} cannot be read: {error}",
            where=str(folder),
            remedy="The file was changed after the batch began; restore it.",
        ) from error
    return replay_batch(queue, read_journal(folder / JOURNAL)[0])


def write_summary(folder: Path, record: BatchRecord) -> BatchSummary:
    """Write ``summary.json`` and ``summary.html``, and return the content of the first."""
    summary = summarise(folder, record)
    write_atomic(folder / SUMMARY, canonical_json(summary))
    write_atomic(folder / PAGE, render_batch(summary).encode())
    return summary


def summarise(folder: Path, record: BatchRecord) -> BatchSummary:
    """Return the content of ``summary.json`` of a batch, finished or not."""
    runs, details, unread = _read_runs(folder, record)
    finished = [run.item.key for run in record.with_end if run.ended[-1].how == "finished"]
    ended = [key for key in finished if key in runs]
    solved = [runs[key] for key in ended]
    working = _run_in_progress(folder, record)
    grouped = group_runs(((runs[key], details[key], RunPlace()) for key in ended), "camera")
    items = []
    for run in _in_order_of_begin(record):
        key = run.item.key
        of_key = runs.get(key), details.get(key), unread.get(key)
        items.append(_item(run, folder, *of_key, _outcome(run, working)))
    return {
        "schema": SCHEMA,
        "queue": record.queue.name,
        "zone": record.queue.zone,
        "how": record.ended,
        "why": record.why,
        "begun_utc": _iso(record.begun),
        "ended_utc": _iso(record.last_end),
        "simulated": any(run.simulated for run in runs.values()),
        "rehearsal": record.rehearsal,
        "totals": _totals(items),
        "items": items,
        "cameras": [_camera(*key, of_camera) for key, of_camera in by_camera(solved).items()],
        "charts": find_charts(grouped.groups),
        "requests": [_request(data) for data in record.answered.values()],
    }


def _read_runs(
    folder: Path, record: BatchRecord
) -> tuple[dict[str, IndexedRun], dict[str, RunDetails], dict[str, str]]:
    """Return the runs that have a journal, their details, and why others cannot be read, by the key of the item."""
    runs: dict[str, IndexedRun] = {}
    details: dict[str, RunDetails] = {}
    unread: dict[str, str] = {}
    for key, state in record.runs.items():
        if state.begun and (folder / RUNS / key / JOURNAL).is_file():
            try:
                runs[key], details[key] = read_run_and_details(folder / RUNS / key)
            except BenchError as error:
                unread[key] = str(error)
    return runs, details, unread


def _camera(camera: str, model: str, runs: Sequence[IndexedRun]) -> CameraData:
    """Return the results of one camera and model, and how far its runs agree."""
    return {
        "camera": camera,
        "model": model,
        "runs": len(runs),
        "parameters": agreements(runs),
    }


def _run_in_progress(folder: Path, record: BatchRecord) -> str:
    """Return the name of the run that a process works on: the batch's own, or one that outlived it; else empty."""
    if not record.current_run:
        return ""
    run = folder / RUNS / record.current_run
    return record.current_run if is_locked(folder) or (run.is_dir() and is_locked(run)) else ""


def _in_order_of_begin(record: BatchRecord) -> list[RunState]:
    """Return the runs in the order in which they began; runs that did not begin are last, by priority."""
    never = datetime.max.replace(tzinfo=record.begun.tzinfo if record.begun else None)
    runs = [record.runs[item.key] for item in by_priority([run.item for run in record.runs.values()])]
    return sorted(runs, key=lambda run: run.begun[0] if run.begun else never)


def _item(
    state: RunState,
    folder: Path,
    run: IndexedRun | None,
    details: RunDetails | None,
    unread: str | None,
    how: str,
) -> ItemData:
    item, attempts = state.item, state.ended
    path = f"{RUNS}/{item.key}"
    stated = run or IndexedRun()
    return {
        "item": item.key,
        "job": item.job.name,
        "folder": path,
        "how": how,
        "why": unread or (attempts[-1].why if attempts and how != IN_PROGRESS else ""),
        "attempts": len(state.begun),
        "begun_utc": _iso(state.begun[0]) if state.begun else None,
        "ended_utc": _iso(attempts[-1].ended) if attempts else None,
        "took_s": round(sum(attempt.duration_s for attempt in attempts), 1) if attempts else None,
        "tries": [
            {"begun_utc": each.begun.isoformat(), "ended_utc": each.ended.isoformat(), "how": each.how}
            for each in attempts
        ],
        "report": f"{path}/{REPORT}" if (folder / path / REPORT).is_file() else None,
        "camera": stated.camera,
        "poses": _planned_poses(folder / path),
        "accepted": stated.accepted,
        "recordings": stated.recordings,
        "deviations": stated.deviations,
        "temperature_c": stated.temperature_c,
        "model": stated.model,
        "rms_px": stated.rms_px,
        "sealed": stated.sealed,
        "parameters": parameters_data(stated.parameters),
        "ledger_number": stated.ledger_number,
        "ledger_head": stated.ledger_head,
        "conformity": details["conformity"] if details else None,
        "goals_missed": goals_missed(details["untils"]) if details else [],
        "causes": cause_sentences(stated.causes),
    }


def _outcome(run: RunState, working: str) -> str:
    """Return how a run ended, or why it has no end; ``working`` is the name of the run in progress."""
    if run.item.key == working:
        return IN_PROGRESS
    if run.withdrawn:
        return "withdrawn"
    if run.ended:
        return run.ended[-1].how
    return "cut off" if run.begun else "not begun"


def _totals(items: Sequence[ItemData]) -> TotalsData:
    begun = [item["begun_utc"] for item in items if item["begun_utc"]]
    ended = [item["ended_utc"] for item in items if item["begun_utc"] and item["ended_utc"]]
    return {
        "runs": len(items),
        "by_end": dict(sorted(Counter(item["how"] for item in items).items())),
        "attempts": sum(item["attempts"] for item in items),
        "poses": sum(item["accepted"] for item in items),
        "recordings": sum(item["recordings"] for item in items),
        "deviations": sum(item["deviations"] for item in items),
        "hours": round(_hours_between(begun[0], max(ended)), 3) if ended else 0.0,
        "working_hours": round(sum(item["took_s"] or 0.0 for item in items) / 3600.0, 3),
    }


def _hours_between(begin_utc: str, end_utc: str) -> float:
    return (datetime.fromisoformat(end_utc) - datetime.fromisoformat(begin_utc)).total_seconds() / 3600.0


def _request(data: Requested) -> RequestData:
    return {
        "word": data["word"],
        "by": data.get("by", ""),
        "taken": data["taken"],
        "why": data["why"],
        "job": data.get("name") or data.get("job", {}).get("name", ""),
    }


def _planned_poses(run: Path) -> int | None:
    """Return the number of poses in a run's plan; None if there is no plan, or if the run chooses their number."""
    plan = read_plan(run)
    return None if plan.fault or plan.untils else len(plan.poses)


def _iso(moment: datetime | None) -> str | None:
    return moment.isoformat() if moment else None


def missed_goals(run: Path) -> tuple[str, ...]:
    """Return the goals that a run missed, as sentences; none if its journal cannot be read."""
    try:
        return tuple(goals_missed(StoredRun(run).history.decisions))
    except BenchError:
        return ()


def summary_lines(summary: BatchSummary, folder: Path) -> Iterator[str]:
    """Return the end of a batch in a folder, its runs, means with their U, and how runs without a result go on."""
    how = summary["how"] or "not ended"
    rehearsal = "REHEARSAL of batch" if summary["rehearsal"] else "Batch"
    yield f"{rehearsal} {batch_name(summary)}: {how}{': ' if summary['why'] else ''}{summary['why']}"
    for item in summary["items"]:
        why = f": {item['why']}" if item["why"] else ""
        verdict = f"  {item['conformity']}" if item["conformity"] else ""
        attempts = f"{item['attempts']} attempt{'' if item['attempts'] == 1 else 's'}"
        yield f"  {item['item']:<30} {item['how']:<10} {attempts}{verdict}{why}"
        yield from (f"    {sentence}" for sentence in [*item.get("causes", ()), *item["goals_missed"]])
    for camera in summary["cameras"]:
        yield from _mean_lines(camera)
    for group in filter(needs_attention, summary["charts"]["groups"]):
        yield f"{group['title']}: {group['verdict']}"
    if summary["how"] == "failed" and not summary["rehearsal"]:
        yield from to_go_on(folder, (item["item"] for item in summary["items"] if item["how"] != "finished"))


def to_go_on(folder: Path, runs: Iterable[str]) -> list[str]:
    """Return how runs without a result go on, once the cause is removed: their batch begins none of them again."""
    begun = [folder / RUNS / run for run in runs if (folder / RUNS / run / JOURNAL).exists()]
    commands = [f"  {pasteable('resume', run.absolute())}" for run in begun]
    return ["When the cause is removed, these runs go on:", *commands] if begun else []


def batch_name(summary: BatchSummary) -> str:
    """Return the name of a batch, and that its devices are simulated, as messages and the terminal show it."""
    mark = " (SIMULATED)" if summary["simulated"] and not summary["rehearsal"] else ""
    return f"{summary['queue']}{mark}"


def _mean_lines(camera: CameraData) -> list[str]:
    """Return one line per parameter of a camera, if more than one of its runs has a result."""
    parameters = camera["parameters"]
    if not parameters:
        return []
    factors = factors_text(parameter["coverage_factor"] for parameter in parameters)
    lines = [
        f"Camera {camera['camera']}, {camera['model']} model, {camera['runs']} results; U with {factors}:"
    ]
    width = max(len(parameter["name"]) for parameter in parameters)
    for agreed in parameters:
        mean, expanded = with_uncertainty(agreed["mean"], agreed["expanded"])
        line = f"  {agreed['name']:<{width}} {mean:>12} ± {expanded:<9} {unit_text(agreed['name']):<3}"
        line += f" Birge {agreed['birge']:.2f}"
        lines.append(f"{line}  REPEATS" if agreed["repeats"] else line)
    if any(parameter["repeats"] for parameter in parameters):
        lines.append(f"  REPEATS: {REPEATS_TEXT}")
    return lines
