"""Output of the commands about batches: text for people, JSON for programs (`bench.commands.batch_commands`)."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.batch.batch_plan import BatchPlan, plan_batch, read_job, read_queue
from bench.batch.batch_summary import PAGE, read_batch, write_summary
from bench.commands.calibration_output import unit_text
from bench.commands.output import STOPPED, print_json
from bench.plan.plan_text import duration_text, size_text
from bench.report.text import with_uncertainty
from sequences.queue import Queue

if TYPE_CHECKING:
    from bench.results.forecasts import PlanForecast
    from calib.studies.planning import Forecast

_SHOWN = ("fx", "cx", "cy", "r")
_MOST_LINES = 80
_K = 2.0


def do_batch(queue: Path, folder: Path, *, as_json: bool) -> int:
    """Do a batch, then print how it ended: every run, and each camera's parameters over the batch.

    folder: Folder of the batch; the batch continues if it has begun there.
    as_json: Whether to print JSON.
    Raises EvidenceError: If the signing key cannot be used by processes without a terminal; nothing has begun
      then.
    """
    if sys.platform != "linux":
        raise UsageError(
            "A batch can be done only on Linux, because its supervision of runs needs Linux.",
            where=str(queue),
            remedy="Do its runs one by one with `starbench run`. `plan` and `rehearse` accept the queue here too.",
        )
    from bench.base.home import home_folder
    from bench.batch.batch import Batch
    from bench.evidence.keys import usable_key
    from bench.terminal.signals import stop_on_signals

    clock = BenchClock()
    usable_key(home_folder(), clock.utc_now())
    batch = Batch(folder, read_queue(queue), clock, lambda line: click.echo(line, err=True))
    with stop_on_signals(clock.request_stop):
        summary = batch.run()
    return show_summary(folder, summary, as_json=as_json)


def summarise_again(folder: Path, *, as_json: bool) -> int:
    """Write and print the current summary of a batch.

    as_json: Whether to print JSON.
    """
    return show_summary(folder, write_summary(folder, read_batch(folder)), as_json=as_json)


def show_summary(folder: Path, summary: Mapping[str, Any], *, as_json: bool) -> int:
    """Print how a batch ended.

    summary: Content of `summary.json`.
    as_json: Whether to print JSON.
    """
    status = {"finished": 0, "aborted": STOPPED}.get(summary["how"], 1)
    if as_json:
        print_json(summary)
        return status
    how = summary["how"] or "not ended"
    rehearsal = "REHEARSAL of batch" if summary["rehearsal"] else "Batch"
    click.echo(f"{rehearsal} {summary['queue']}: {how}{': ' if summary['why'] else ''}{summary['why']}")
    for item in summary["items"]:
        why = f": {item['why']}" if item["why"] else ""
        click.echo(f"  {item['item']:<30} {item['how']:<10} {_attempts(item['attempts'])}{why}")
    for camera in summary["cameras"]:
        for line in _trend_lines(camera):
            click.echo(line)
    click.echo(f"Summary: {folder / PAGE}")
    return status


def _attempts(count: int) -> str:
    return f"{count} attempt{'' if count == 1 else 's'}"


def _trend_lines(camera: Mapping[str, Any]) -> list[str]:
    """Return one line per parameter of a camera, if more than one of its runs has a result."""
    lines = []
    for trend in camera["parameters"]:
        mean, expanded = with_uncertainty(trend["mean"], _K * trend["sigma"])
        unit = unit_text(trend["name"])
        line = f"  {trend['name']:<3} {mean:>12} ± {expanded:<9} {unit:<3} Birge {trend['birge']:.2f}"
        if trend["per_hour"] is not None:
            slope, slope_u = with_uncertainty(trend["per_hour"]["value"], _K * trend["per_hour"]["sigma"])
            line += f"  {slope:>10} ± {slope_u} per hour{'  CHANGES' if trend['per_hour']['seen'] else ''}"
        lines.append(line)
    if lines:
        head = f"Camera {camera['camera']}, {camera['model']} model, {len(camera['runs'])} results; U with k = 2:"
        lines.insert(0, head)
    return lines


def ask_batch(folder: Path, *, job: Path | None, name: str | None, by: str | None, as_json: bool) -> int:
    """Add a job to a batch or withdraw one, and print the answer.

    job: File of the job to add; None to withdraw one.
    by: Name of the operator; user@host where None.
    as_json: Whether to print JSON.
    """
    from bench.batch.batch_requests import Request, answer_text, send_request
    from bench.run.control import operator_at_terminal

    who = by or operator_at_terminal()
    if job is not None:
        request = Request(word="add", by=who, job=read_job(job))
    else:
        request = Request(word="withdraw", by=who, name=name)
    answer = send_request(folder, request)
    if as_json:
        print_json({"schema": "starbench/answer/1", **(answer or {"taken": None, "why": "not answered yet"})})
    else:
        click.echo(answer_text(answer), err=answer is not None and not answer["taken"])
    return 0 if answer is None or answer["taken"] else 1


# ---------------------------------------------------------------- before a night


def do_rehearsal(
    queue: Path, folder: Path, *, begin: datetime | None, seed: int, quiet: bool, as_json: bool
) -> int:
    """Rehearse a batch on a virtual clock, and print how it would end.

    begin: Time at which the night begins, in the time zone of the queue; now where None.
    quiet: Whether to print only the summary.
    as_json: Whether to print JSON.
    """
    from bench.batch.rehearsed_night import rehearse_batch

    read, started_s = read_queue(queue), time.monotonic()
    summary = rehearse_batch(
        read,
        folder,
        begin=_begin(read.value, begin),
        seed=seed,
        say=lambda line: None if quiet else click.echo(line, err=True),
    )
    status = show_summary(folder, summary, as_json=as_json)
    took_s = time.monotonic() - started_s
    whole = duration_text(3600 * summary["totals"]["hours"])
    click.echo(f"{whole} rehearsed in {took_s:.0f} s.", err=True)
    return status


def show_night(queue: Path, *, begin: datetime | None, as_json: bool) -> int:
    """Print when each run of a queue begins and ends, and for which runs there is no time.

    The expected uncertainty of each job is printed too.

    begin: Time at which the night begins, in the time zone of the queue; now where None.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    from bench.results.forecasts import expected_uncertainty

    read = read_queue(queue)
    night = plan_batch(read.value, _begin(read.value, begin))
    forecasts = {name: expected_uncertainty(planned) for name, planned in night.plans.items()}
    if as_json:
        expected = {name: dict(found.forecast.sigma) if found else None for name, found in forecasts.items()}
        print_json({**night.to_dict(), "expected_sigma": expected})
    else:
        click.echo(_night_text(night, forecasts))
    return 0


def _begin(queue: Queue, begin: datetime | None) -> datetime:
    """Return the begin in UTC, now where it is None; a time without a zone is in the queue's time zone."""
    if begin is None:
        return datetime.now(UTC)
    return (begin.replace(tzinfo=queue.tzinfo) if queue.tzinfo else begin).astimezone(UTC)


def _night_text(night: BatchPlan, forecasts: Mapping[str, PlanForecast | None]) -> str:
    zone = night.queue.tzinfo

    def clock(at_s: float) -> str:
        return f"{night.moment(at_s).astimezone(zone):%a %H:%M}"

    begins = f"{night.moment(night.bounds.opens_s).astimezone(zone):%a %Y-%m-%d %H:%M %Z}"
    lines = [f"{night.queue.name}: from {begins}", "", f"{'begin':<10} {'end':<10} {'takes':>12}  run"]
    rows = [
        f"{clock(slot.begin_s):<10} {clock(slot.end_s):<10} {duration_text(slot.end_s - slot.begin_s):>12}"
        f"  {slot.item.key}"
        for slot in night.slots
        if slot.begin_s is not None and slot.end_s is not None
    ]
    if len(rows) > _MOST_LINES:
        half = _MOST_LINES // 2
        rows = [*rows[:half], f"... {len(rows) - 2 * half} runs ...", *rows[-half:]]
    lines += rows
    if night.without_time:
        lines += [
            "",
            f"No time for {len(night.without_time)}: {', '.join(item.key for item in night.without_time)}",
        ]
    lines += ["", f"{'job':<16} {'a run takes':>12} {'disk':>8}  expected U (about 95 %)"]
    for name, planned in night.plans.items():
        found = forecasts[name]
        expected = _expected_text(found.forecast) if found else "unknown"
        lines.append(
            f"{name:<16} {duration_text(planned.duration_s):>12} {size_text(planned.size_bytes):>8}  {expected}"
        )
    runs = len(night.slots) - len(night.without_time)
    end = f"{night.end.astimezone(zone):%a %H:%M %Z}"
    return "\n".join([*lines, "", f"{runs} runs, until {end}, about {size_text(night.size_bytes)} on disk."])


def _expected_text(forecast: Forecast) -> str:
    """Return the expected expanded uncertainties of a job, with their coverage factor."""
    k = forecast.coverage_factor
    values = ", ".join(f"{n} {k * forecast.sigma[n]:.2g}" for n in _SHOWN if n in forecast.sigma)
    return f"{values} (k = {k:.3g})"


def refuse_extra(queue: Path, station: str | None, suggest: int) -> None:
    """Refuse options of a sequence that are given with a queue, because a queue names its stations itself.

    station: Value of ``--station``.
    suggest: Value of ``--suggest``.
    Raises UsageError: If either option is given.
    """
    if station or suggest:
        raise UsageError(
            "A queue names its stations itself.",
            where=str(queue),
            remedy="Leave --station and --suggest out.",
        )
