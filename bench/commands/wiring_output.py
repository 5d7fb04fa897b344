"""Test the wiring of a station, and print what was seen. A person is asked before the light comes on."""

from __future__ import annotations

import sys

import click

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.commands.output import print_json


def show_wiring(station_name: str, seed: int, *, yes: bool, as_json: bool) -> int:
    """Ask, test the wiring, and print the result.

    seed: Random seed of a simulated bench.
    yes: Whether the person has agreed already.
    as_json: Whether to print JSON.
    Returns: Exit status: 0 if the wiring is right, 1 if it is not, 3 if the person refused.
    Raises UsageError: If nobody can be asked.
    """
    from bench.run.wiring import FREQUENCY_HZ, check_wiring
    from bench.stations.devices import Devices
    from bench.stations.station import load_station

    station = load_station(station_name).value
    if not yes:
        if not sys.stdin.isatty():
            raise UsageError(
                "The wiring test switches the light on, and nobody can be asked.",
                remedy="Run it at a terminal, or give --yes.",
            )
        asked = f"The light will flicker at {FREQUENCY_HZ:g} Hz for about 2 s. Nothing moves. Continue?"
        if not click.confirm(asked, err=True):
            click.echo("Nothing was done.", err=True)
            return 3
    clock = BenchClock()
    devices = Devices(station, seed=seed, clock=clock, wire_log=None)
    try:
        report = check_wiring(devices, station, clock)
    finally:
        devices.close()
    if as_json:
        print_json(report.to_dict())
        return int(bool(report.faults))
    click.echo(f"Seen: {report.seen}.")
    for fault in report.faults:
        click.echo(f"{fault.name}: {fault.what} {fault.remedy}")
    if not report.faults:
        click.echo(
            "The wiring is right: channel, polarity and number of the trigger edges agree with the light."
        )
    return int(bool(report.faults))
