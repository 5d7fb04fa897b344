"""The command `devices`: what is connected, and with ``--wiring`` a test of the trigger cable."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.commands.options import SEED, STATION_NAME, epilog
from bench.commands.output import JSON, STOPPED, show

if TYPE_CHECKING:
    from bench.run.wiring import WiringReport
    from bench.stations.station_draft import Discovery


@click.command(epilog=epilog("starbench devices"))
@click.option(
    "--wiring",
    is_flag=True,
    help="Test the cable from the light to the camera's trigger input: the light flickers.",
)
@click.option("--station", "-s", type=STATION_NAME, help="Station for --wiring.")
@click.option("--yes", is_flag=True, help="With --wiring: switch the light on without asking.")
@click.option("--seed", type=SEED, metavar="N", default=1, hidden=True)
@JSON
def devices(wiring: bool, station: str | None, yes: bool, seed: int) -> int:
    """List connected devices, their names for a station file, and missing software.

    Sends nothing to stages and lights. The camera makers' software asks each camera for its name.

    With --wiring and --station: asks, switches the light on for 2 s at 20 Hz, and compares trigger edges with events.
    Names a trigger cable that is missing, inverted, on the wrong channel, or of the wrong level. Nothing moves.
    """
    if wiring:
        if station is None:
            raise click.UsageError("Missing option '--station' / '-s', which --wiring needs.")
        return _show_wiring(station, seed, yes=yes)
    from bench.stations.station_draft import discover

    return show_devices(discover())


def show_devices(found: Discovery) -> int:
    """Print the connected devices and the missing software."""
    plugins = _plugins()
    show(lambda: {**found.to_dict(), "plugins": plugins}, _device_lines(found, plugins))
    return 0


def _device_lines(found: Discovery, plugins: list[dict[str, str]]) -> Iterator[str]:
    for port in found.ports:
        note = f"  ({port.note})" if port.note else ""
        yield f"serial port  {port.name}  {port.what}{note}"
    for camera in found.cameras:
        trouble = f"  ({camera.trouble})" if camera.trouble else ""
        keys = {"driver": camera.driver, "source": camera.source, "serial": camera.serial}
        entry = "  ".join(f"{name}: {value}" for name, value in keys.items() if value)
        yield f"camera       {entry}  # {camera.description}{trouble}"
    for plugin in plugins:
        trouble = f"  (cannot be used: {plugin['trouble']})" if plugin["trouble"] else ""
        yield f"plug-in      {plugin['driver']}  {plugin['kind']}  # {plugin['package']}{trouble}"
    for sentence in found.missing:
        yield f"missing      {sentence}"
    yield (
        "simulated    -s simulated, simulated_board, simulated_frames, simulated_ideal, simulated_unaligned: "
        "stations without devices"
    )


def _plugins() -> list[dict[str, str]]:
    """Return the drivers that other packages bring, with the trouble of those that cannot be used."""
    from bench.stations.sections import GROUPS, plugins

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


def _show_wiring(station_name: str, seed: int, *, yes: bool) -> int:
    """Ask, test the wiring, print the result; exit status 0: right, 1: not, 3: the person refused."""
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
            return STOPPED
    clock = BenchClock()
    devices = Devices(station, seed=seed, clock=clock, wire_log=None)
    try:
        report = check_wiring(devices, station, clock)
    finally:
        devices.close()
    show(report.to_dict, _wiring_lines(report))
    return int(bool(report.faults))


def _wiring_lines(report: WiringReport) -> Iterator[str]:
    yield f"Seen: {report.seen}."
    for fault in report.faults:
        yield f"{fault.name}: {fault.what} {fault.remedy}"
    if not report.faults:
        yield "The wiring is right: channel, polarity and number of the trigger edges agree with the light."
