"""The command `simulate`: a simulated bench in a process of its own."""

from __future__ import annotations

import signal
import sys
import threading

import click

from bench.base.errors import BenchError
from bench.commands.options import SEED, STATION_NAME, epilog


@click.command(epilog=epilog("starbench simulate --station simulated --seed 1"))
@click.option(
    "--station",
    "-s",
    "station_name",
    default="simulated",
    type=STATION_NAME,
    show_default=True,
    help="Station whose devices to simulate.",
)
@click.option(
    "--seed", type=SEED, metavar="N", default=1, show_default=True, help="Random seed of the simulated bench."
)
def simulate(station_name: str, seed: int) -> int:
    """Keep a simulated bench running in its own process, and print its ports.

    Write a line to standard input to simulate a fault, e.g. pan stall share=0.3 (docs/simulated-bench.md lists all).
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
