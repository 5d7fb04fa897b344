"""`starbench devices --wiring` on the simulated bench, with each fault of the sync cable."""

import pytest
from click.testing import CliRunner

from bench.base.clock import BenchClock
from bench.commands.cli import cli
from bench.run.wiring import check_wiring
from bench.stations.devices import Devices
from bench.stations.station import load_station


@pytest.mark.slow
def test_each_fault_of_the_cable_is_named():
    clock, station = BenchClock(), load_station("simulated").value
    devices = Devices(station, seed=1, clock=clock, wire_log=None)
    found = {}
    try:
        for fault in (
            "",
            "no_sync",
            "sync_inverted",
            "sync_channel factor=1",
            "sync_weak factor=0.3",
            "lamp_open",
        ):
            if fault:
                devices.simulation.order(f"light {fault}")
            report = check_wiring(devices, station, clock)
            assert not devices.light.is_on()
            found[fault.split(" ")[0]] = [one.name for one in report.faults]
            devices.simulation.order("light mend")
    finally:
        devices.close()
    assert found == {
        "": [],
        "no_sync": ["trigger cable missing"],
        "sync_inverted": ["inverted"],
        "sync_channel": ["wrong channel"],
        "sync_weak": ["sync level"],
        "lamp_open": ["no light"],
    }


def test_the_light_stays_dark_where_nobody_can_be_asked():
    result = CliRunner().invoke(cli, ["devices", "--wiring", "--station", "simulated"], input="")
    assert result.exit_code != 0
    assert "nobody can be asked" in str(result.exception) + result.output
