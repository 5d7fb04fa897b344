"""What commands print: results and errors in words for people, or as one JSON object for programs.

Knows how to say things, and does the little that belongs to saying them (asking for a passphrase, waiting beside a
simulated bench). Results and errors come from the modules that make them.
"""

from __future__ import annotations

import errno
import json
import signal
import sqlite3
import sys
import threading
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.errors import BenchError, EvidenceError, ScriptError, StorageError, UsageError
from sequences.errors import DocumentFaults

if TYPE_CHECKING:
    from bench.evidence.verify import Verification
    from bench.results.offline import OfflineResult
    from bench.run.runner import RunEnd
    from bench.stations.discovery import Discovery
    from calib.studies.reference_methods import Baseline, NoAnswer

STOPPED = 3


def print_json(value: Mapping[str, Any]) -> None:
    """Print one object on standard output."""
    click.echo(json.dumps(value, indent=1, allow_nan=False))


# ---------------------------------------------------------------- runs and calibrations


def show_run(end: RunEnd, *, as_json: bool) -> int:
    """Tell how a run ended; return the exit status."""
    status = {"finished": 0, "aborted": STOPPED}.get(end.how, 1)
    report = str(end.outcome.report) if end.outcome else None
    if as_json:
        facts = {
            "ended": end.how,
            "why": end.why,
            "unsafe": list(end.unsafe),
            "folder": str(end.folder),
            "report": report,
        }
        results = end.outcome.results if end.outcome else {}
        print_json({**facts, **dict(results.get("calibration", {})), "results": dict(results) or None})
        return status
    if end.outcome is None:
        click.echo(f"The run {'was aborted' if end.how == 'aborted' else 'failed'}: {end.why}", err=True)
        if not end.unsafe:
            click.echo("The bench is safe: stage stopped, light off.", err=True)
        click.echo(f"What was recorded is kept; go on with:\n  starbench resume {end.folder}", err=True)
        return status
    click.echo(_run_text(end.outcome.results))
    click.echo(f"Report: {report}")
    return status


def print_calibration(
    result: OfflineResult, baselines: list[Baseline | NoAnswer] | None, *, as_json: bool
) -> None:
    """Show a calibration made without devices, and other methods on the same points where asked for."""
    from bench.console.engine_output import baseline_dict, comparison_text

    if as_json:
        told = result.to_dict()
        if baselines is not None:
            told["compared"] = [baseline_dict(row) for row in baselines]
        print_json(told)
        return
    for line in result.skipped:
        click.echo(f"left out: {line}", err=True)
    click.echo(calibration_text(result.calibration.to_dict()))
    if baselines is not None:
        click.echo("\n" + comparison_text(baselines))
    elif result.planar is not None:
        click.echo("\nThe planar model (Zhang) on the same points, for comparison:")
        click.echo(calibration_text(result.planar.to_dict()))


def _run_text(results: Mapping[str, Any]) -> str:
    lines = [calibration_text(results["calibration"])]
    if results["comparison"]:
        lines += ["", "SIMULATED devices. Distance from the simulated truth:"]
        lines += [_distance_text(row) for row in results["comparison"]]
    lines += [f"Deviation: {what}" for what in results["deviations"]]
    return "\n".join([*lines, ""])


def _distance_text(row: Mapping[str, Any]) -> str:
    """Tell how far a value lies from the truth, to the digits of its uncertainty."""
    from bench.report.text import fixed, with_uncertainty

    error, _ = with_uncertainty(row["error"], 2 * row["sigma"])
    sigmas = fixed(row["error_sigmas"], 2)
    return f"  {row['name']:<3} {error:>12} {unit_text(row['name']):<3} = {sigmas:>5} sigma"


def calibration_text(calibration: Mapping[str, Any]) -> str:
    """Lay out a calibration: values with uncertainties first, reprojection error second."""
    from bench.report.calibration_tables import coverage_factor
    from bench.report.text import exact, with_uncertainty

    values = {**calibration["camera"], **(calibration["collimator"] or {})}
    views = calibration["views"]
    stars = sum(view["n"] for view in views)
    k = coverage_factor(calibration)
    model = calibration["model"].capitalize()
    counted = f"{len(views)} view{'' if len(views) == 1 else 's'}"
    lines = [f"{model} model, {counted}, {stars} stars; U with k = {exact(round(k, 2))}:"]
    for name, sigma in calibration["sigma"].items():
        value, expanded = with_uncertainty(values[name], k * sigma)
        lines.append(f"  {name:<3} {value:>12} ± {expanded:<8} {unit_text(name)}".rstrip())
    lines.append(
        f"Reprojection error: rms {calibration['rms_px']:.4f} px, mean {calibration['mean_px']:.4f} px"
        " (how well the model follows the stars; not how accurate it is)."
    )
    if not calibration["converged"]:
        lines.append("NOT CONVERGED: these numbers are no result.")
    return "\n".join([*lines, *(f"Note: {note}" for note in calibration["notes"])])


def unit_text(name: str) -> str:
    """Give a parameter's unit as it is printed behind a number; nothing for a pure number."""
    from bench.report.text import unit_of

    unit = unit_of(name)
    return "" if unit == "1" else unit


def show_verification(verification: Verification, *, as_json: bool) -> int:
    """Tell whether a run folder is what was sealed; return the exit status."""
    if as_json:
        print_json(verification.to_dict())
    elif verification.ok:
        click.echo(
            f"Verified: {verification.files} files as sealed by {verification.signer} ({verification.fingerprint})."
        )
        if verification.run_id is not None:
            simulated = " SIMULATED devices." if verification.simulated else ""
            camera = verification.camera_serial or "without number"
            click.echo(f"Run {verification.run_id}, camera {camera}.{simulated}")
        for remark in verification.remarks:
            click.echo(f"Not checked: {remark}.")
    else:
        click.echo("NOT VERIFIED:", err=True)
        for fault in verification.faults:
            click.echo(f"  {fault}", err=True)
    return 0 if verification.ok else 1


# ---------------------------------------------------------------- errors


def tell_error(error: Exception, *, as_json: bool, debug: bool) -> int:
    """Tell an error in plain words; return the exit status."""
    if isinstance(error, DocumentFaults):
        error = ScriptError([str(fault) for fault in error.faults])
    kind, message, remedy = _words_of(error)
    foreseen = kind != "defect"
    if as_json:
        said: dict[str, Any] = {"kind": kind, "message": message, "remedy": remedy}
        if isinstance(error, ScriptError):
            said["faults"] = error.faults
        print_json({"error": said})
    click.echo(f"starbench: {message}", err=True)
    if debug or not foreseen:
        click.echo("".join(traceback.format_exception(error)), err=True)
    return getattr(error, "exit_status", 1)


def _words_of(error: Exception) -> tuple[str, str, str]:
    """Give kind, message and remedy of an error; kind ``defect`` for one that nobody foresaw."""
    if hasattr(error, "what") and hasattr(error, "remedy"):
        hint = _hint_of_home(error)
        return type(error).__name__, f"{error}{hint}", f"{error.remedy}{hint}"
    if isinstance(error, OSError):
        remedy = {
            errno.ENOSPC: "Make room on the disk.",
            errno.EACCES: "Check the permissions.",
            errno.EPERM: "Check the permissions.",
            errno.EROFS: "Use a folder that can be written.",
            errno.ENAMETOOLONG: "Choose a shorter name.",
        }.get(error.errno or 0, "Check the path and the disk.")
        where = f"{error.filename}: " if error.filename else ""
        return type(error).__name__, f"{where}{error.strerror or error}. {remedy}", remedy
    if isinstance(error, sqlite3.Error):
        from bench.evidence.keys import home_folder

        remedy = "Make room, check the permissions, or name another folder in STARBENCH_HOME."
        return (
            type(error).__name__,
            f"{home_folder()}: The bench's files are not usable: {error}. {remedy}",
            remedy,
        )
    message = f"This is a defect in Starbench, not in what you did: {type(error).__name__}: {error}"
    return "defect", message, "Please report it with the lines below."


def _hint_of_home(error: Exception) -> str:
    """Tell how the bench's own folder is named, where that is what could not be written."""
    from bench.evidence.keys import home_folder

    if not isinstance(error, StorageError) or not error.where:
        return ""
    home, where = home_folder().absolute(), Path(error.where).absolute()
    if where != home and home not in where.parents and where not in home.parents:
        return ""
    return " The bench's own folder can be another: name it in STARBENCH_HOME."


# ---------------------------------------------------------------- keys, schemas, the simulated bench


def ask_passphrase(key: Path) -> bytes:
    """Ask for a key's passphrase at the terminal."""
    if not sys.stdin.isatty():
        raise EvidenceError(
            "The signing key has a passphrase, and there is no terminal to ask for it.",
            where=str(key),
            remedy="Run at a terminal, or use a key without one for unattended runs.",
        )
    answer: str = click.prompt(f"Passphrase of {key}", hide_input=True, err=True)
    return answer.encode()


def show_keys() -> int:
    """Show the bench's key and the keys it trusts."""
    from bench.evidence.keys import KEY_FILE, SIGNERS_FILE, home_folder, load_key, read_signers
    from bench.evidence.sshsig import fingerprint

    home = home_folder()
    if not (home / KEY_FILE).exists():
        click.echo("This bench has no key yet; one is made at the first run, or by `starbench keys create`.")
    else:
        key = load_key(home, ask_passphrase=ask_passphrase)
        click.echo(
            f"Key:         {home / KEY_FILE}\nFingerprint: {key.fingerprint}\nGive to those who verify:"
        )
        click.echo(f"  {key.signers_line}")
    if (home / SIGNERS_FILE).exists():
        click.echo(f"Trusted here ({home / SIGNERS_FILE}):")
        for signer in read_signers(home / SIGNERS_FILE):
            click.echo(f"  {signer.principal}  {fingerprint(signer.public_key)}")
    return 0


def make_key(principal: str | None, *, protect: bool) -> int:
    """Make the bench's key."""
    from bench.evidence.keys import create_key, home_folder
    from bench.records.storage import make_folder

    passphrase: str | None = None
    if protect:
        passphrase = click.prompt("Passphrase", hide_input=True, confirmation_prompt=True, err=True)
    make_folder(home_folder())
    key = create_key(
        home_folder(), principal=principal, passphrase=passphrase.encode() if passphrase else None
    )
    click.echo(f"Made {key.fingerprint}. Give to those who verify:\n  {key.signers_line}")
    return 0


def trust_key(line: str) -> int:
    """Trust another bench's key."""
    from bench.evidence.keys import home_folder, trust
    from bench.evidence.sshsig import fingerprint
    from bench.records.storage import make_folder

    make_folder(home_folder())
    try:
        signer = trust(home_folder(), line)
    except EvidenceError as error:
        raise UsageError(error.what, where=error.where, remedy=error.remedy) from error
    click.echo(f"Trusted: {signer.principal}  {fingerprint(signer.public_key)}")
    return 0


def show_devices(found: Discovery, *, as_json: bool) -> int:
    """Show what is connected and what is missing."""
    if as_json:
        print_json(found.to_dict())
        return 0
    for port in found.ports:
        note = f"  ({port.note})" if port.note else ""
        click.echo(f"serial port  {port.name}  {port.what}{note}")
    for camera in found.cameras:
        trouble = f"  ({camera.trouble})" if camera.trouble else ""
        told = {"driver": camera.driver, "source": camera.source, "serial": camera.serial}
        words = "  ".join(f"{name}: {value}" for name, value in told.items() if value)
        click.echo(f"camera       {words}  # {camera.description}{trouble}")
    for sentence in found.missing:
        click.echo(f"missing      {sentence}")
    click.echo("simulated    -s simulated, -s simulated_frames: stations that need no device")
    return 0


def write_station(path: Path, name: str, stage: str, camera: str | None, found: Discovery) -> int:
    """Write a new station file; never over another."""
    from bench.records.storage import write_whole
    from bench.stations.placeholders import ASK
    from bench.stations.station_draft import draft_station

    if path.exists():
        raise UsageError("There is a file of this name.", where=str(path), remedy="Choose another.")
    write_whole(path, draft_station(name, found, stage=stage, camera=camera).encode())
    click.echo(
        f"Written: {path}. Replace every {ASK}, check scales and limits, then: starbench plan three_pose -s {path}"
    )
    return 0


def print_schema(document: str) -> int:
    """Print the JSON Schema of a kind of file."""
    from pydantic import BaseModel

    from bench.stations.station import Station
    from sequences.queue import JobFile, Queue
    from sequences.schema import Sequence

    models: dict[str, type[BaseModel]] = {
        "sequence": Sequence,
        "station": Station,
        "queue": Queue,
        "job": JobFile,
    }
    print_json(models[document].model_json_schema())
    return 0


def serve_simulated_bench(station_name: str, seed: int) -> int:
    """Keep a simulated bench running until somebody stops it; lines on standard input order faults."""
    from bench.simulated import SimulatedBench
    from bench.stations.station import load_station

    station = load_station(station_name).value
    if station.simulation is None:
        raise BenchError(
            "This station has no simulation section.",
            where=station_name,
            remedy="Use the station `simulated`.",
        )
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with SimulatedBench(station.simulation, seed) as bench:
        for name, port in bench.endpoints.items():
            click.echo(f"{name:<8} {port}")
        click.echo(
            "Ports of the simulated bench, as a station file names them. A line here orders a fault"
            " (pan stall share=0.3); Ctrl-C ends it.",
            err=True,
        )

        def obey() -> None:
            for line in sys.stdin:
                click.echo(bench.order(line))

        threading.Thread(target=obey, daemon=True).start()
        while bench.alive and not stop.wait(0.5):
            pass
        if not bench.alive:
            raise BenchError("The simulated bench ended by itself.", where=station_name)
    return 0
