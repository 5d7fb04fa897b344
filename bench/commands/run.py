"""The commands `run` and `resume`, and how the end of a run is printed."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.pasteable import pasteable
from bench.commands.calibrations import calibration_lines
from bench.commands.options import (
    RUN,
    RUN_STATUS,
    SEED,
    SEQUENCE_NAME,
    SET,
    STATION,
    OutputFolder,
    command,
    settings_of,
)
from bench.commands.output import JSON, NOT_KEPT, STOPPED, ask_passphrase, error_object, show
from bench.record.journal import CAPTURES
from bench.record.run_folder import REPORT
from bench.wording.camera_check import check_sentences
from bench.wording.causes import cause_sentences
from bench.wording.conformity import conformity_headline, conformity_sentences
from bench.wording.goals import goals_missed
from bench.wording.numbers import fixed, with_uncertainty
from bench.wording.parameters import unit_text
from bench.wording.target_words import STARS

if TYPE_CHECKING:
    from bench.record.results import ComparisonRow
    from bench.run.runner import RunEnd

_MOST_LISTED = 20
"""Recordings that are listed by name: a screen."""


@command(
    "starbench run three_pose --station simulated",
    "starbench run nine_pose -s my_bench.yaml -o runs/cam7 --operator 'A. Operator'",
    "starbench run nine_pose -s my_bench.yaml --expect-serial 00051234",
    "starbench run three_pose -s simulated --set sequence.defaults.record.window_ms=50",
    status=RUN_STATUS,
)
@click.argument("sequence", type=SEQUENCE_NAME)
@STATION
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="New folder for the run.  [default: a folder in runs/, named by date and sequence]",
)
@click.option("--seed", type=SEED, metavar="N", help="Random seed of the simulated bench.")
@click.option("--operator", metavar="NAME", help="Name of the operator; printed in the report.")
@click.option(
    "--expect-serial",
    metavar="SERIAL",
    help="Refuse every camera with another serial number, before anything moves; -: read the serial number from"
    " standard input, such as the line of a scanner.",
)
@SET
@JSON
def run(
    sequence: str,
    station: str,
    output: Path | None,
    seed: int | None,
    operator: str | None,
    expect_serial: str | None,
    settings: tuple[str, ...],
) -> int:
    """Run a SEQUENCE on a station and write a sealed report.

    SEQUENCE is a file, or the name of a sequence that is included (three_pose, nine_pose, turntable, until_good,
    parallax_test).

    The first Ctrl-C stops the run safely: it stops the stage, switches the light off and closes the files. The third
    Ctrl-C ends the process at once.
    """
    from bench.base.clock import BenchClock
    from bench.run.launch import Launch, start_run

    end = start_run(
        sequence,
        station,
        output=output,
        seed=seed,
        operator=operator,
        launch=Launch(BenchClock(), ask_passphrase=ask_passphrase),
        settings=settings_of(settings),
        expect_serial=sys.stdin.readline() if expect_serial == "-" else expect_serial,
    )
    return show_run(end)


@command("starbench resume runs/cam7 --dry-run", "starbench resume runs/cam7", status=RUN_STATUS)
@RUN
@click.option("--dry-run", is_flag=True, help="Only print what would be done.")
@JSON
def resume(run_folder: Path, dry_run: bool) -> int:
    """Continue a RUN that was stopped, failed or was interrupted. It first prints what it will do."""
    from bench.base.clock import BenchClock
    from bench.run.launch import Launch, read_intentions, resume_run

    if dry_run:
        lines = list(read_intentions(run_folder))
        show({"schema": "starbench/intentions/1", "intentions": lines}, "\n".join(lines))
        return 0
    launch = Launch(BenchClock(), ask_passphrase=ask_passphrase)
    return show_run(resume_run(run_folder, launch))


def show_run(end: RunEnd) -> int:
    """Print how a run ended; exit status 0 finished, 3 stopped on request, 4 finished but FAIL, 1 failed."""
    early = end.outcome is None and end.how != "finished"
    show(lambda: _run_dict(end), _early_end_lines(end) if early else _ended_lines(end), err=early)
    if end.how != "finished":
        return STOPPED if end.how == "aborted" else 1
    conformity = end.outcome.results.get("conformity") if end.outcome else None
    return NOT_KEPT if conformity and not conformity.passed else 0


def _run_dict(end: RunEnd) -> dict[str, Any]:
    facts = {
        "ended": end.how,
        "why": end.why,
        "unsafe": list(end.unsafe),
        "devices": end.devices,
        "folder": str(end.folder),
        "report": str(end.outcome.report) if end.outcome else None,
        "error": error_object(end.failure) if end.failure is not None else None,
    }
    results: Mapping[str, Any] = end.outcome.results if end.outcome else {}
    return {**facts, **dict(results.get("calibration", {})), "results": dict(results) or None}


def _ended_lines(end: RunEnd) -> Iterator[str]:
    if end.outcome is None:
        yield from _recorded_lines(end)
        return
    results = end.outcome.results
    causes = cause_sentences(end.outcome.causes)
    yield from causes
    yield from goals_missed(results.get("untils") or [])
    if check := results.get("check"):
        yield from check_sentences(check)
    if conformity := results.get("conformity"):
        yield conformity_headline(conformity)
        yield from (f"  {sentence}" for sentence in conformity_sentences(conformity))
        yield ""
    from bench.record.stored_calibration import stored_calibration

    calibration = stored_calibration(results["calibration"])
    notes = tuple(note for note in calibration.notes if note not in causes)
    yield from calibration_lines(replace(calibration, notes=notes), STARS)
    if results["comparison"]:
        yield from ("", "SIMULATED devices. Distance from the simulated truth:")
        yield from map(_distance_text, results["comparison"])
    for what in results["deviations"]:
        yield f"Deviation: {what}"
    yield from ("", f"Report: {end.outcome.report}")


def _distance_text(row: ComparisonRow) -> str:
    """Return how far a value lies from the truth, to the digits of its uncertainty."""
    error, _ = with_uncertainty(row.error, 2 * row.sigma)
    sigmas = fixed(row.error_sigmas, 2)
    return f"  {row.name:<3} {error:>12} {unit_text(row.name):<3} = {sigmas:>5} sigma"


def _early_end_lines(end: RunEnd) -> list[str]:
    """Return why a run ended early, what is known of the bench, and how to continue."""
    return [
        f"The run {'was aborted' if end.how == 'aborted' else 'failed'}: {end.why}",
        *_device_lines(end),
        end.way_on[0],
        f"  {end.way_on[1]}",
        *([f"Report: {end.folder / REPORT}"] if (end.folder / REPORT).is_file() else []),
    ]


def _device_lines(end: RunEnd) -> list[str]:
    """Return what is known of each device; nothing is said that no device has answered."""
    if all(device.state == "never opened" for device in end.devices):
        return [
            "No device was ready, so none has answered.",
            "Look at the bench: the stage may turn, and the light may be on.",
        ]
    unsure = [device for device in end.devices if device.state != "confirmed safe"]
    if end.devices and not unsure:
        head = "The bench is safe; each device confirmed it:"
        if not end.opened:  # a resumed run that needed none
            head = "No device was needed. Each confirmed before that it was safe:"
    elif end.devices and all(confirmation.device == "camera" for confirmation in unsure):
        head = "Stage and light confirmed that they are safe:"  # a camera neither moves nor shines
    else:
        head = "CHECK THE BENCH. What is known of each device:"
    return [head, *(f"  {device.text}" for device in end.devices)]


def _recorded_lines(end: RunEnd) -> list[str]:
    """Return what a run without results has: its recordings, and what can be done with them."""
    recordings = sorted(
        path.relative_to(end.folder).as_posix() for path in (end.folder / CAPTURES).glob("pose-*")
    )
    lines = ["The run is finished and sealed. Its sequence has no report step, so there is no result."]
    lines.append(f"Folder: {end.folder}")
    if not recordings:
        return [*lines, "It has no recording."]
    shown = recordings[:_MOST_LISTED]
    lines.append(f"Recordings ({len(recordings)}):")
    lines += [f"  {name}" for name in shown]
    if len(recordings) > len(shown):
        lines.append(f"  and {len(recordings) - len(shown)} more")
    lines.append("To check the seal, and to calibrate from the recordings:")
    return [
        *lines,
        f"  {pasteable('verify', end.folder)}",
        f"  {pasteable('calibrate', end.folder, '--output', f'{end.folder}-calibrated')}",
    ]
