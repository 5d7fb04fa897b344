"""Print devices, schemas and new station files; keep a simulated bench running until it is stopped."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.errors import BenchError, UsageError
from bench.commands.output import print_json

if TYPE_CHECKING:
    from bench.stations.discovery import Discovery


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
    from bench.records.storage import write_atomic
    from bench.stations.placeholders import ASK
    from bench.stations.station_draft import draft_station

    if path.exists():
        raise UsageError("There is a file of this name.", where=str(path), remedy="Choose another.")
    write_atomic(path, draft_station(name, found, stage=stage, camera=camera).encode())
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
