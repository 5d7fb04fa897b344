"""The command `plan`: a sequence or a queue is checked; its times, sizes and expected uncertainty are printed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.encoding import size_text
from bench.base.errors import UsageError
from bench.commands.options import BEGIN, SEQUENCE_NAME, SET, STATION_NAME, command, settings_of
from bench.commands.output import JSON, show
from bench.commands.values import WholeNumber
from bench.wording.numbers import angle_text, duration, number
from calib.model.result_parts import WORST_CORNER
from sequences.kinds import QUEUE, kind_of_file

if TYPE_CHECKING:
    from bench.batch.batch_plan import BatchPlan
    from bench.plan.plan import Plan
    from bench.solve.expectations import PlanForecast
    from calib.model.result_parts import BudgetRow
    from calib.studies.planning import Forecast, WeighedPose
    from sequences.queue import Queue

_MOST_TERMS = 5  # Rows of the budget that are printed, the largest
_SMALLEST_SHARE = 0.005
"""Terms with a smaller share of the variance are not printed: without them, U is smaller by a quarter of a per cent."""
_SHOWN = ("fx", "cx", "cy", "r")
_PACE_TOLD_FROM = 1.1  # Below, earlier runs took as long as a plan can say
_MOST_LINES = 80  # Two screens; of a longer table begin and end are shown


@command(
    "starbench plan three_pose --station my_bench.yaml --suggest 3",
    "starbench plan night.yaml --begin 2026-03-01T21:00",
)
@click.argument("sequence", type=SEQUENCE_NAME)
@click.option(
    "--station",
    "-s",
    type=STATION_NAME,
    help="Station file, or the name of a station that is included; not with a queue.",
)
@click.option(
    "--suggest",
    type=WholeNumber(0, 50),
    metavar="N",
    default=0,
    help="Suggest N further poses that lower the uncertainty most.",
)
@BEGIN
@SET
@JSON
def plan(
    sequence: str, station: str | None, suggest: int, begin: datetime | None, settings: tuple[str, ...]
) -> int:
    """Check a SEQUENCE on a station, or a queue file. No device is used.

    For a sequence, it shows all faults of both files, the steps, the time, the disk space and the expected uncertainty.
    For a queue, it shows when each run will begin and end, and which runs do not fit into the night.
    """
    from bench.plan.plan import load_documents, make_plan

    if kind_of_file(Path(sequence)) is QUEUE:
        if station or suggest:
            raise UsageError(
                "A queue names its stations itself.",
                where=sequence,
                remedy="Leave --station and --suggest out.",
            )
        return _show_night(Path(sequence), begin)
    if station is None:
        raise click.UsageError("Missing option '--station' / '-s'.")
    return _show_plan(make_plan(*load_documents(sequence, station, settings_of(settings))), suggest)


def _show_plan(planned: Plan, suggest: int) -> int:
    """Print a plan, its expected uncertainty, and suggested additional poses; return 2 if the files have faults."""
    if planned.faults:  # the engine is not needed, and it takes a second to load
        show(lambda: _plan_dict(planned, None, []), _plan_lines(planned, None, []))
        return 2
    from bench.solve.expectations import expected_uncertainty
    from bench.solve.forecasts import suggest_poses

    forecast = expected_uncertainty(planned)
    suggested = suggest_poses(planned, suggest) if suggest else []
    show(lambda: _plan_dict(planned, forecast, suggested), _plan_lines(planned, forecast, suggested))
    return 0


def _plan_dict(
    planned: Plan, forecast: PlanForecast | None, suggested: Sequence[WeighedPose]
) -> dict[str, Any]:
    poses = [
        {
            **pose.angles_deg,
            "worst_px": pose.after.worst_px,
            "rim_share": round(pose.rim_share, 3),
            "why": f"largest uncertainty on the sensor {number(pose.after.worst_px, 2)} px, 1 sigma",
        }
        for pose in suggested
    ]
    return {
        **planned.to_dict(),
        "missing_software": _missing_software(planned),
        "expected": _forecast_dict(forecast),
        "expected_untils": [asdict(course) for course in forecast.courses] if forecast else [],
        "suggested": poses,
    }


def _plan_lines(
    planned: Plan, plan_forecast: PlanForecast | None, suggested: Sequence[WeighedPose]
) -> Iterator[str]:
    from bench.record.pace import pace_on
    from bench.wording.plan_text import render_plan

    yield from render_plan(planned).split("\n")
    pace = pace_on(planned.station.value.name)
    if pace.factor > _PACE_TOLD_FROM:
        yield f"{pace.text()} That makes about {duration(pace.factor * planned.duration_s)}."
    yield from _missing_software(planned)
    if plan_forecast is not None:
        yield ""
        yield from (course.text for course in plan_forecast.courses)
        yield from _forecast_lines(plan_forecast)
        yield from plan_forecast.remarks
    if suggested:
        from bench.solve.forecasts import forecasts_with

        before = None if plan_forecast is None or plan_forecast.chosen else plan_forecast.forecast
        for pose, forecast in zip(suggested, forecasts_with(planned, suggested), strict=True):
            yield _suggestion_text(pose, before, forecast)
            before = forecast


def _missing_software(planned: Plan) -> list[str]:
    """Return, as sentences, what this computer lacks in order to use the camera of the station."""
    from drivers.camera.camera_software import missing_software

    return [
        f"Missing for a run on this computer: {text}"
        for text in missing_software(planned.station.value.camera.driver)
    ]


def _forecast_dict(plan_forecast: PlanForecast | None) -> dict[str, Any] | None:
    """Return a forecast for programs."""
    if plan_forecast is None or plan_forecast.forecast is None:
        return None
    forecast = plan_forecast.forecast
    return {
        "model": "joint",
        "poses": plan_forecast.poses,
        "chosen_in_run": plan_forecast.chosen,
        "sigma": dict(forecast.sigma),
        "coverage_factor": forecast.coverage_factor,
        "expanded_fx_px": forecast.limited["expanded_fx"],
        "worst_corner_px": forecast.limited[WORST_CORNER],
        "worst_px": forecast.projection_map.worst_px,
        "stars": list(forecast.stars),
        "budget_rows": [asdict(row) for row in forecast.budget_rows],
        "remarks": list(plan_forecast.remarks),
    }


def _forecast_lines(plan_forecast: PlanForecast) -> Iterator[str]:
    """Yield a forecast for people: expanded uncertainties, and the largest terms."""
    from calib.uncertainty.projection_uncertainty import URAD_PER_ARCSEC

    forecast = plan_forecast.forecast
    if forecast is None:
        return
    k = forecast.coverage_factor
    fx, corners = forecast.limited["expanded_fx"], forecast.limited[WORST_CORNER]
    direction = angle_text(URAD_PER_ARCSEC * k * forecast.projection_map.worst_arcsec)
    yield f"Expected with {plan_forecast.poses_text}, joint model; U with k = {k:.3g}:"
    yield f"  U(fx) {number(fx, 2)} px, U at the corners {number(corners, 2)} px, U of a direction at most {direction}"
    yield f"  {'largest parts of U, px':<44}{'fx':>8}{'corners':>10}"
    for row in _largest(forecast.budget_rows):
        parts = [k * row.contribution.get(name, 0.0) for name in ("fx", WORST_CORNER)]
        yield f"  {row.name:<44}{number(parts[0], 2):>8}{number(parts[1], 2):>10}"


def _largest(rows: Sequence[BudgetRow]) -> list[BudgetRow]:
    """Return the rows that matter for the focal length or at the corners, the largest first."""
    share = {row.name: max(row.share.get("fx", 0.0), row.share.get(WORST_CORNER, 0.0)) for row in rows}
    shown = sorted(rows, key=lambda row: -share[row.name])[:_MOST_TERMS]
    return [row for row in shown if share[row.name] >= _SMALLEST_SHARE]


def _suggestion_text(pose: WeighedPose, before: Forecast | None, forecast: Forecast | None) -> str:
    """Return a suggested pose with the uncertainty that it is expected to give."""
    angles = ", ".join(f"{name}: {round(a, 3):g}" for name, a in pose.angles_deg.items())
    parts = ["the poses do not determine the camera yet"] if forecast is None else []
    if forecast is not None:
        for name, quantity in (("U(fx)", "expanded_fx"), ("U at the corners", WORST_CORNER)):
            instead = f" instead of {number(before.limited[quantity], 2)} px" if before is not None else ""
            parts.append(f"{name} {number(forecast.limited[quantity], 2)} px{instead}")
        parts[-1] += f" (k = {forecast.coverage_factor:.3g})"
    return f"Suggested: {{{angles}}}: {', '.join(parts)}"


def _show_night(queue: Path, begin: datetime | None) -> int:
    """Print when each run of a queue begins and ends, for which there is no time, and what each job will reach."""
    from bench.batch.batch_plan import plan_batch, read_queue
    from bench.record.pace import paces, runs_of_bench
    from bench.solve.expectations import expected_uncertainty

    read = read_queue(queue)
    night = plan_batch(read.value, begin_utc(read.value, begin), paces(runs_of_bench()))
    forecasts = {name: expected_uncertainty(planned) for name, planned in night.plans.items()}
    expected = {
        name: dict(forecast.forecast.sigma) if forecast and forecast.forecast else None
        for name, forecast in forecasts.items()
    }
    untils = {
        name: [asdict(course) for course in forecast.courses]
        for name, forecast in forecasts.items()
        if forecast
    }
    show(
        lambda: {**night.to_dict(), "expected_sigma": expected, "expected_untils": untils},
        _night_lines(night, forecasts),
    )
    return 0


def begin_utc(queue: Queue, begin: datetime | None) -> datetime:
    """Return the begin of a night in UTC, now where it is None; without a zone it is in the queue's time zone."""
    if begin is None:
        return datetime.now(UTC)
    return (begin.replace(tzinfo=queue.tzinfo) if queue.tzinfo else begin).astimezone(UTC)


def _night_lines(night: BatchPlan, forecasts: Mapping[str, PlanForecast | None]) -> Iterator[str]:
    from bench.batch.batch_record import NEVER_S

    zone = night.queue.tzinfo

    def clock(at_s: float) -> str:
        return f"{night.moment(at_s).astimezone(zone):%a %H:%M}"

    begins = f"{night.moment(night.bounds.opens_s).astimezone(zone):%a %Y-%m-%d %H:%M %Z}"
    if night.bounds.done_by_s != NEVER_S:  # the next such time may be tomorrow's
        begins += f"; no run is begun that would end after {clock(night.bounds.done_by_s)}"
    for text in night.slow:
        yield from (text, "")
    most = "at most " if any(planned.untils for planned in night.plans.values()) else ""
    takes = f"takes {most}".strip()
    yield from (f"{night.queue.name}: from {begins}", "")
    yield f"{'begin':<10} {'end':<10} {takes:>13}  run"
    rows = [
        f"{clock(slot.begin_s):<10} {clock(slot.end_s):<10} {duration(slot.end_s - slot.begin_s):>13}"
        f"  {slot.item.key}"
        for slot in night.slots
        if slot.begin_s is not None and slot.end_s is not None
    ]
    if len(rows) > _MOST_LINES:
        half = _MOST_LINES // 2
        rows = [*rows[:half], f"... {len(rows) - 2 * half} runs ...", *rows[-half:]]
    yield from rows
    if night.without_time:
        left_out = ", ".join(item.key for item in night.without_time)
        yield from ("", f"No time for {len(night.without_time)}: {left_out}")
    yield ""
    yield f"{'job':<16} {'a run takes':>20} {'disk':>15}  expected U (about 95 %)"
    for name, planned in night.plans.items():
        yield from _job_lines(name, planned, forecasts[name])
    runs = len(night.slots) - len(night.without_time)
    end = f"{night.end.astimezone(zone):%a %H:%M %Z}{' at the latest' if most else ''}"
    yield from ("", f"{runs} runs, until {end}, {most}about {size_text(night.size_bytes)} on disk.")


def _job_lines(name: str, planned: Plan, forecast: PlanForecast | None) -> Iterator[str]:
    """Yield what a run of a job takes and reaches; with an ``until``, the most that it takes, and how it will end."""
    most = "at most " if planned.untils else ""
    takes, size = f"{most}{duration(planned.duration_s)}", f"{most}{size_text(planned.size_bytes)}"
    expected = _expected_text(forecast.forecast) if forecast and forecast.forecast else "unknown"
    expected += f", with {forecast.poses_text}" if forecast and forecast.courses else ""
    yield f"{name:<16} {takes:>20} {size:>15}  {expected}"
    for course in forecast.courses if forecast else ():
        yield f"{'':<16} {course.text}"


def _expected_text(forecast: Forecast) -> str:
    """Return the expected expanded uncertainties of a job, with their coverage factor."""
    k = forecast.coverage_factor
    values = ", ".join(f"{n} {number(k * forecast.sigma[n], 2)}" for n in _SHOWN if n in forecast.sigma)
    return f"{values} (k = {k:.3g})"
