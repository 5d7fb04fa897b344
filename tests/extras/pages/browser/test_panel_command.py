"""Commands that show the bench: panel, simulate, devices."""

import json
import re
import signal
import subprocess
from contextlib import closing, contextmanager
from pathlib import Path

import httpx
import pytest
from click.testing import CliRunner
from running import STARBENCH, called, environment, killed_at_end, start, start_python
from slow_cases import slow

from bench.base.clock import BenchClock
from bench.commands.cli import cli
from bench.run.wiring import check_wiring
from bench.stations.devices import Devices
from bench.stations.station import load_station

TOKEN = "0123456789abcdef"


@pytest.fixture
def root(run):
    return run.folder.parent


@contextmanager
def panel(root, *words, home):
    """A panel under way, and the first line that it prints."""
    with killed_at_end(start("panel", root, "--no-browser", *words, home=home)) as process:
        yield process, process.stdout.readline().strip()


@pytest.mark.parametrize("number", [signal.SIGINT, slow(signal.SIGTERM)])
def test_the_first_line_is_the_address_and_ctrl_c_ends_it_quietly(root, tmp_path, number):
    with panel(root, home=tmp_path) as (process, line):
        url, token = re.fullmatch(r"(http://127\.0\.0\.1:\d+/)sign-in#token=(\S{22,})", line).groups()
        assert httpx.get(url).status_code == 401
        signed = {"Authorization": f"Bearer {token}"}
        assert "Runs and batches" in httpx.get(url, headers=signed).text
        with httpx.stream(
            "GET", f"{url}api/run/run7/events", headers=signed
        ) as stream:  # an open page does not delay the end
            next(stream.iter_lines())
            process.send_signal(number)
            out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err.strip()) == (130, "", "Stopped.")


def test_other_computers_need_a_token_which_no_address_holds(root, tmp_path, monkeypatch):
    words = ("panel", root, "--no-browser", "--no-token", "--host", "0.0.0.0")
    refused = called(*words, home=tmp_path, status=2)
    assert "need a token" in refused.stderr
    monkeypatch.setenv("STARBENCH_PAGE_TOKEN", TOKEN)
    with panel(root, "--host", "0.0.0.0", home=tmp_path) as (process, url):
        assert TOKEN not in url
        local = f"http://127.0.0.1:{url.rsplit(':', 1)[1]}"
        assert httpx.get(f"{local}api/run/run7/state").status_code == 401
        signed = {"Authorization": f"Bearer {TOKEN}"}
        assert httpx.get(f"{local}api/run/run7/state", headers=signed).status_code == 200
        options = Path(f"/proc/{process.pid}/cmdline")
        if options.exists():
            assert TOKEN not in options.read_text()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert TOKEN not in out + err


# ---------------------------------------------------------------- simulate


@pytest.fixture
def simulated(tmp_path):
    words = (*STARBENCH[1:], "simulate", "--seed", "3")
    with killed_at_end(start_python(*words, stdin=subprocess.PIPE, **environment(tmp_path))) as process:
        yield process


def test_it_prints_its_ports_obeys_orders_and_leaves_nothing_behind(simulated):
    ports = dict(simulated.stdout.readline().split() for _ in range(4))
    assert set(ports) == {"gimbal", "light", "camera", "frame-camera"}
    assert Path(ports["gimbal"]).is_char_device()
    for order, ok in (("pan stall share=0.3", True), ("pan fly", False)):
        simulated.stdin.write(order + "\n")
        simulated.stdin.flush()
        assert json.loads(simulated.stdout.readline())["ok"] is ok
    simulated.send_signal(signal.SIGINT)
    assert simulated.wait(timeout=30) == 0
    assert not Path(ports["gimbal"]).exists()


# ---------------------------------------------------------------- wiring


@pytest.mark.slow
def test_each_fault_of_the_cable_is_named():
    clock, station = BenchClock(), load_station("simulated").value
    faults_of = {}
    with closing(Devices(station, seed=1, clock=clock, wire_log=None)) as devices:
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
            faults_of[fault.split(" ")[0]] = [named.name for named in report.faults]
            devices.simulation.order("light mend")
    assert faults_of == {
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
