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
    """Print the connected devices and the missing software.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    if as_json:
        print_json({**found.to_dict(), "plugins": _plugins()})
        return 0
    for port in found.ports:
        note = f"  ({port.note})" if port.note else ""
        click.echo(f"serial port  {port.name}  {port.what}{note}")
    for camera in found.cameras:
        trouble = f"  ({camera.trouble})" if camera.trouble else ""
        keys = {"driver": camera.driver, "source": camera.source, "serial": camera.serial}
        entry = "  ".join(f"{name}: {value}" for name, value in keys.items() if value)
        click.echo(f"camera       {entry}  # {camera.description}{trouble}")
    for plugin in _plugins():
        trouble = f"  (cannot be used: {plugin['trouble']})" if plugin["trouble"] else ""
        click.echo(f"plug-in      {plugin['driver']}  {plugin['kind']}  # {plugin['package']}{trouble}")
    for sentence in found.missing:
        click.echo(f"missing      {sentence}")
    click.echo(
        "simulated    -s simulated, simulated_board, simulated_frames, simulated_ideal, simulated_unaligned: "
        "stations without devices"
    )
    return 0


def _plugins() -> list[dict[str, str]]:
    """Return the drivers that other packages bring, with the trouble of those that cannot be used."""
    from bench.stations.plugins import GROUPS, plugins

    return [
        {
            "driver": plugin.name,
            "kind": kind,
            "package": plugin.package,
            "trouble": plugin.trouble,
        }
        for kind in GROUPS
        for plugin in plugins(kind)
    ]


def write_station(
    path: Path, name: str, *, stage: str, light: str, camera: str | None, found: Discovery
) -> int:
    """Write a new station file, never over an existing one.

    camera: Kind of camera; the connected one where None.
    Returns: Exit status, 0.
    Raises UsageError: If the file exists.
    """
    from bench.records.storage import write_atomic
    from bench.stations.placeholders import UNKNOWN_SERIAL
    from bench.stations.station_draft import draft_station

    if path.exists():
        raise UsageError(
            "A file with this name already exists.", where=str(path), remedy="Choose another name."
        )
    write_atomic(path, draft_station(name, found, stage=stage, light=light, camera=camera).encode())
    click.echo(
        f"Written: {path}. Replace every placeholder (such as {UNKNOWN_SERIAL}), check scales and limits, then:"
        f" starbench plan three_pose -s {path}"
    )
    return 0


def print_schema(document: str) -> int:
    """Print the JSON Schema of a kind of file.

    Returns: Exit status, 0.
    """
    from pydantic import BaseModel

    from bench.certificate.lab_config import LabConfig
    from bench.stations.station import Station
    from sequences.queue import JobFile, Queue
    from sequences.schema import Sequence

    models: dict[str, type[BaseModel]] = {
        "sequence": Sequence,
        "station": Station,
        "queue": Queue,
        "job": JobFile,
        "lab": LabConfig,
    }
    print_json(models[document].model_json_schema())
    return 0


def serve_simulated_bench(station_name: str, seed: int) -> int:
    """Keep a simulated bench running until it is stopped; each line of standard input orders a fault.

    station_name: Station file, or the name of a station that is included.
    Returns: Exit status, 0.
    Raises BenchError: If the station has no simulation section, or the simulated bench ends unasked.
    """
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
    with SimulatedBench(station.simulated_world, seed) as bench:
        for name, port in bench.endpoints.items():
            click.echo(f"{name:<8} {port}")
        click.echo(
            "These are the ports of the simulated bench, as a station file names them. To simulate a fault, write a"
            " line (e.g. pan stall share=0.3). To turn the lens by hand, write: lens turn deg=5. Ctrl-C ends the"
            " simulated bench.",
            err=True,
        )

        def obey_orders() -> None:
            for line in sys.stdin:
                click.echo(bench.order(line))

        threading.Thread(target=obey_orders, daemon=True).start()
        while bench.alive and not stop.wait(0.5):
            pass
        if not bench.alive:
            raise BenchError("The simulated bench ended by itself.", where=station_name)
    return 0
