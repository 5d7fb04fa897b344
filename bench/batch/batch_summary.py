"""Summary of a batch: every run, the reasons of failures, and the trend of each camera's parameters.

Uses the batch's journal and the journals of its runs. The summary is written as ``summary.json`` and ``summary.html``,
and can be written again at any time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, RunFolderError
from bench.batch.batch_events import Requested
from bench.batch.batch_record import BatchRecord, RunAttempt, replay_batch
from bench.batch.schedule import Item, by_priority
from bench.history.chart_findings import find_charts
from bench.history.chart_groups import group_runs
from bench.history.merged_runs import RunPlace
from bench.records.estimates import parameters_data
from bench.records.journal import read_journal
from bench.records.reading import read_json
from bench.records.run_folder import JOURNAL, PLAN, REPORT
from bench.records.run_index import QUEUE_COPY, IndexedRun, is_batch, read_run_and_details
from bench.records.storage import write_atomic
from bench.report.batch_page import render_batch
from bench.results.trends import by_camera, hours_after, trends_of
from sequences.errors import DocumentFaults
from sequences.queue import Queue
from sequences.reader import read_document

RUNS = "runs"
SUMMARY, PAGE = "summary.json", "summary.html"
SCHEMA = "starbench/batch/1"
_NO_PLACE = {"ledger_number": None, "ledger_head": None}


def read_batch(folder: Path) -> BatchRecord:
    """Read the state of a batch from its folder; changes nothing and disturbs no process.

    Raises RunFolderError: When there is no batch in the folder.
    Raises JournalBroken: When its journal is not intact.
    """
    if not is_batch(folder):
        raise RunFolderError(
            "There is no batch in this folder.",
            where=str(folder),
            remedy="Give the --output folder of `starbench batch`.",
        )
    try:
        queue = read_document(folder / QUEUE_COPY, Queue).value
    except DocumentFaults as error:
        raise RunFolderError(
            f"{QUEUE_COPY} cannot be read: {error}",
            where=str(folder),
            remedy="The file was changed after the batch began; restore it.",
        ) from error
    return replay_batch(queue, read_journal(folder / JOURNAL)[0])


def write_summary(folder: Path, record: BatchRecord) -> dict[str, Any]:
    """Write ``summary.json`` and ``summary.html``.

    Returns: Content of ``summary.json``.
    Raises StorageError: When a file cannot be written.
    """
    summary = summarise(folder, record)
    write_atomic(folder / SUMMARY, (json.dumps(summary, indent=1, allow_nan=False) + "\n").encode())
    write_atomic(folder / PAGE, render_batch(summary).encode())
    return summary


def summarise(folder: Path, record: BatchRecord) -> dict[str, Any]:
    """Summarise a batch, finished or not.

    Returns: Content of ``summary.json``.
    """
    runs: dict[str, IndexedRun] = {}
    details: dict[str, dict[str, Any]] = {}
    unread: dict[str, str] = {}
    for key in record.attempts:
        if (folder / RUNS / key / JOURNAL).is_file():
            try:
                runs[key], details[key] = read_run_and_details(folder / RUNS / key)
            except BenchError as error:
                unread[key] = str(error)
    ended = [key for key, end in record.ends.items() if end.how == "finished" and key in runs]
    solved = [runs[key] for key in ended]
    grouped = group_runs(((runs[key], details[key], RunPlace()) for key in ended), "camera")
    items = [_item(item, record, folder, runs.get(item.key), unread) for item in _in_order_of_begin(record)]
    return {
        "schema": SCHEMA,
        "queue": record.queue.name,
        "zone": record.queue.zone,
        "how": record.ended,
        "why": record.why,
        "begun_utc": _iso(record.begun),
        "ended_utc": _iso(max((end.ended for end in record.ends.values()), default=None)),
        "simulated": any(run.simulated for run in runs.values()),
        "rehearsal": record.rehearsal,
        "totals": _totals(items),
        "items": items,
        "cameras": [
            {
                "camera": camera,
                "model": model,
                "runs": [_point(run) for run in of_camera],
                "parameters": [trend.to_dict() for trend in trends_of(of_camera)],
            }
            for (camera, model), of_camera in by_camera(solved).items()
        ],
        "charts": find_charts(grouped.groups),
        "requests": [_request(data) for data in record.answered.values()],
    }


def newest_place(summary: Mapping[str, Any]) -> tuple[int, str] | None:
    """Return the place of the newest run of a batch in the bench's ledger.

    summary: From `summarise`.
    Returns: Number of the run, and hash of its line; None if no run is in a ledger.
    """
    places = [
        (item["ledger_number"], item["ledger_head"]) for item in summary["items"] if item["ledger_head"]
    ]
    return max(places, default=None)


def _in_order_of_begin(record: BatchRecord) -> list[Item]:
    """Return the runs in the order in which they began; runs that did not begin are last, by priority."""
    never = datetime.max.replace(tzinfo=record.begun.tzinfo if record.begun else None)
    return sorted(by_priority(list(record.items.values())), key=lambda i: record.begun_at.get(i.key, never))


def _item(
    item: Item, record: BatchRecord, folder: Path, run: IndexedRun | None, unread: Mapping[str, str]
) -> dict[str, Any]:
    end, path = record.ends.get(item.key), f"{RUNS}/{item.key}"
    return {
        "item": item.key,
        "job": item.job.name,
        "folder": path,
        "how": _outcome(item, record),
        "why": unread.get(item.key) or (end.why if end else ""),
        "attempts": record.attempts.get(item.key, 0),
        "begun_utc": _iso(record.begun_at.get(item.key)),
        "ended_utc": _iso(end.ended) if end else None,
        **_attempt_times(record.ended_attempts.get(item.key, [])),
        "report": f"{path}/{REPORT}" if (folder / path / REPORT).is_file() else None,
        **_run_facts(run, _planned_poses(folder / path)),
    }


def _outcome(item: Item, record: BatchRecord) -> str:
    """Return how a run ended, or why it has no end."""
    if item.key in record.withdrawn:
        return "withdrawn"
    if item.key in record.ends:
        return record.ends[item.key].how
    return "cut off" if item.key in record.attempts else "not begun"


def _attempt_times(attempts: Sequence[RunAttempt]) -> dict[str, Any]:
    """Return the total duration of the attempts, s, and the times of each."""
    return {
        "took_s": round(sum(one.duration_s for one in attempts), 1) if attempts else None,
        "tries": [
            {"begun_utc": _iso(one.begun), "ended_utc": _iso(one.ended), "how": one.how} for one in attempts
        ],
    }


def _run_facts(run: IndexedRun | None, planned_poses: int | None) -> dict[str, Any]:
    """Return what a run's own journal says about it; default values if it has none."""
    if run is None:
        counts = {"accepted": 0, "recordings": 0, "deviations": 0}
        result: dict[str, Any] = {
            "temperature_c": None,
            "model": None,
            "rms_px": None,
            "sealed": False,
            "parameters": {},
        }
        return {"camera": "", "poses": planned_poses, **counts, **result, **_NO_PLACE}
    return {
        "camera": run.camera,
        "poses": planned_poses,
        "accepted": run.accepted,
        "recordings": run.recordings,
        "deviations": run.deviations,
        "temperature_c": run.temperature_c,
        "model": run.model,
        "rms_px": run.rms_px,
        "sealed": run.sealed,
        "parameters": parameters_data(run.parameters),
        "ledger_number": run.ledger_number,
        "ledger_head": run.ledger_head,
    }


def _point(run: IndexedRun) -> dict[str, Any]:
    return {
        "item": run.id,
        "begun_utc": run.begun_utc,
        "temperature_c": run.temperature_c,
        "parameters": parameters_data(run.parameters),
    }


def _totals(items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    counted: dict[str, int] = {}
    for item in items:
        counted[item["how"]] = counted.get(item["how"], 0) + 1
    begun = [item for item in items if item["begun_utc"]]
    ended = [item["ended_utc"] for item in begun if item["ended_utc"]]
    return {
        "runs": len(items),
        "by_end": dict(sorted(counted.items())),
        "attempts": sum(item["attempts"] for item in items),
        "poses": sum(item["accepted"] for item in items),
        "recordings": sum(item["recordings"] for item in items),
        "deviations": sum(item["deviations"] for item in items),
        "hours": round(hours_after(max(ended), begun[0]["begun_utc"]), 3) if ended else 0.0,
        "working_hours": round(sum(item["took_s"] or 0.0 for item in begun) / 3600.0, 3),
    }


def _request(data: Requested) -> dict[str, Any]:
    what = data.get("name") or (data.get("job") or {}).get("name", "")
    return {k: data.get(k, "") for k in ("word", "by", "taken", "why")} | {"job": what}


def _planned_poses(run: Path) -> int | None:
    """Return the number of poses in a run's plan; None if there is no plan, or if the run chooses their number."""
    try:
        plan = read_json(run / PLAN)
        return None if plan.get("untils") else len(plan["poses"])
    except (BenchError, ValueError, KeyError):
        return None


def _iso(moment: datetime | None) -> str | None:
    return moment.isoformat() if moment else None
