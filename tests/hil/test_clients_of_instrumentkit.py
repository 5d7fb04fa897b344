"""InstrumentKit, a client that others wrote, with the simulated stages and generator.

Its licence is the AGPL, so it is installed by hand and used here only as a check. Its version 0.6 names a package that
breaks Python's own ``enum``: ``pip install --no-deps instrumentkit future python-usbtmc python-vxi11 pyusb quantities
ruamel.yaml pint``. What this version cannot do with a real instrument either is noted at its place.
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from simulators.faults.line_faults import FaultLine
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.esp301 import EspController
from simulators.stages.thorlabs_apt import AptController
from simulators.world.world import World
from tests.hil.direct_stages import K10CR1_COUNTS_PER_DEG

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its own, about its age
    instruments = pytest.importorskip("instruments", reason="pip install instrumentkit")
    agilent = pytest.importorskip("instruments.agilent")
    newport = pytest.importorskip("instruments.newport")
    thorlabs = pytest.importorskip("instruments.thorlabs")

pytestmark = pytest.mark.filterwarnings("ignore")


def plugged(folder: Path, device) -> SerialDevice:
    line = FaultLine(device, time.monotonic, np.random.default_rng(1))
    return SerialDevice(PseudoTerminal(folder / "port"), line)


def value(told) -> float:
    """Return the number of a quantity, of its library before and after the change of 0.7."""
    return float(getattr(told, "magnitude", told))


def test_an_esp_stage_is_homed_moved_and_read(tmp_path):
    models = [AxisModel(Mechanics(6400.0, -17.0, 17.0, start_deg=2.4), "1263")]
    with plugged(tmp_path, EspController(models, time.monotonic)) as device:
        stage = newport.NewportESP301.open_serial(device.address, baud=19_200, timeout=3)
        axis = stage.axis[0]
        axis.enable()
        stage.search_for_home(axis=1, search_mode=1)
        axis.wait_for_motion(poll_interval=0.05, max_wait=20)
        assert value(axis.position) == 0.0
        axis.move(7.5)
        axis.wait_for_motion(poll_interval=0.05, max_wait=20)
        assert value(axis.position) == pytest.approx(7.5, abs=1e-3)
        assert (value(axis.left_limit), value(axis.right_limit)) == (-15.0, 15.0)
        with pytest.raises(Exception, match=r"Newport Error: 6\. Axis: 1\."):  # beyond the positive limit
            axis.move(99.0)


def test_a_generator_is_set_and_read(tmp_path):
    world = World()
    with plugged(tmp_path, ScpiGenerator(GeneratorModel(), world.now_s, world.set_light)) as device:
        one = agilent.Agilent33220a.open_serial(device.address, baud=9600, timeout=3)
        assert "SG0042" in one.query("*IDN?")
        one.load_resistance = one.LoadResistance.high_impedance
        one.sendcmd("FUNC SQU")  # this version sends FUNC:SQU, which no generator knows
        one.frequency = 60.0
        one.amplitude = (4.0, one.VoltageMode.peak_to_peak)
        one.offset = 2.0
        one.duty_cycle = 30
        one.output = True
        assert one.function is one.Function.square
        assert (value(one.frequency), value(one.offset)) == (60.0, 2.0)
        assert float(one.query("FUNC:SQU:DCYC?")) == 30.0  # its own property takes whole numbers only
        assert value(one.amplitude[0]) == 4.0
        assert one.query("OUTP?") == "1"  # its own property waits for ON
    light = world.light(world.now_s())
    assert (light.frequency_hz, light.duty_percent, light.low_v, light.high_v) == (60.0, 30.0, 0.0, 4.0)


def test_a_thorlabs_stage_is_homed_and_moved(tmp_path):
    mechanics = Mechanics(K10CR1_COUNTS_PER_DEG, -17.0, 17.0, start_deg=2.4, stall_detection=False)
    controller = AptController(AxisModel(mechanics, "55000123", 15.0, 10.0, 10.0), time.monotonic)
    with plugged(tmp_path, controller) as device:
        unit = thorlabs.APTMotorController.open_serial(device.address, baud=115_200, timeout=20)
        assert unit.serial_number == (55000123).to_bytes(4, "little").hex()  # as this client shows it
        axis = unit.channel[0]
        axis.go_home()
        home_deg = controller.axis.pointing.angle_deg(time.monotonic())
        axis.move(round(5.0 * K10CR1_COUNTS_PER_DEG))  # returns when the unit tells the end of the move
        # This version reads the first six bytes only of a longer answer, so the position is the simulated unit's.
        assert controller.axis.pointing.angle_deg(time.monotonic()) - home_deg == pytest.approx(5.0, abs=0.01)
