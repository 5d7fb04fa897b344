"""Drivers against simulated controllers behind a line of faults, on a virtual clock: an error, or the truth."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.errors import DriverError, MoveFailed
from drivers.light import LightSettings
from drivers.stage import Stage
from simulators.faults.line_faults import LineFault
from tests.hil.direct_lights import OPENED, direct_light
from tests.hil.direct_stages import FAMILIES, DirectLine, DirectStage, VirtualClock

pytestmark = pytest.mark.usefixtures("never_late")

UNGUARDED = {"flir"}
"""Families whose queries are one bit away from commands that move: PP, the position, from RP, a homing."""
LONGEST_S = 60.0
"""Of the bench's own time: no call may take longer, whatever the line does."""


@pytest.mark.parametrize("exchanges", [pytest.param(4_000), pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("family", FAMILIES)
def test_no_position_and_no_arrival_is_ever_wrong(family, exchanges) -> None:
    clock = VirtualClock()
    rng = np.random.default_rng(7)
    rig = FAMILIES[family](clock, rng)
    stage, line = rig.stage, rig.line
    stage.home()
    good = {"move": 0, "read": 0}
    bad = 0
    where = stage.position_deg()["pan"]
    while len(line.sent) < exchanges:
        kind = "move" if rng.random() < 0.3 else "read"
        goal = float(rng.integers(-15, 15)) if kind == "move" else where
        with spoiled(line, clock, rng):
            try:
                read_deg = go_and_read(stage, goal) if kind == "move" else stage.position_deg()["pan"]
                as_asked = read_deg == pytest.approx(goal, abs=0.002)
                if family in UNGUARDED and (kind == "read" or not as_asked):
                    # A disturbed query may have become a motion, also the one after an arrival.
                    assert read_deg == pytest.approx(rig.present_deg(), abs=0.01)
                    goal = None
                else:
                    assert as_asked
                where = read_deg
                good[kind] += 1
            except DriverError:
                bad += 1
                goal = None
        if not stage.is_homed():
            home_as_told(rig)
            goal = None
        read_deg = stage.position_deg()["pan"]
        assert read_deg == pytest.approx(read_deg if goal is None else goal, abs=0.002)
        assert read_deg == pytest.approx(rig.true_deg(), abs=0.01)
        where = read_deg
    assert min(good.values()) > 5
    assert bad > 0


def home_as_told(rig: DirectStage) -> None:
    """Home; where a changed target has driven a motor into its end, do first what the driver's error says."""
    try:
        rig.stage.home()
    except MoveFailed as error:
        if "switch the controller off and on" not in error.remedy:
            raise
        rig.controller.restart(rig.line.clock.now_s)
        rig.line.clock.sleep(3.0)
        rig.stage.home()


def go_and_read(stage: Stage, goal: float) -> float:
    stage.move_to({"pan": goal})
    return stage.position_deg()["pan"]


@contextmanager
def spoiled(line: DirectLine, clock: VirtualClock, rng: np.random.Generator) -> Iterator[None]:
    """Spoil replies, and requests, at one rate or another for a while; see that it ends in time; then clear the line."""
    chance = float(rng.choice([0.002, 0.02, 0.2]))
    line.device.inject(LineFault("any", count=None, chance=chance))
    line.device.inject(LineFault("stale", count=None, chance=chance / 4))
    for kind in ("request_lost", "request_garbled", "echo", "wrong_id", "wrong_checksum", "missing_checksum"):
        line.device.inject(LineFault(kind, count=None, chance=chance / 8))
    began_s = clock.now_s
    yield
    assert clock.now_s - began_s < LONGEST_S
    line.device.clear()
    clock.sleep(2.0)


@pytest.mark.parametrize("exchanges", [pytest.param(3_000), pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", OPENED)
def test_no_setting_of_a_light_is_ever_wrong(kind, exchanges) -> None:
    clock = VirtualClock()
    rng = np.random.default_rng(8)
    rig = direct_light(kind, clock, rng)
    light, line = rig.light, rig.line
    light.apply(LightSettings())
    good = {"apply": 0, "read": 0}
    bad = 0
    while len(line.sent) < exchanges:
        asked = LightSettings(frequency_hz=float(rng.integers(1, 500)), high_v=float(rng.integers(1, 6)))
        with spoiled(line, clock, rng):
            try:
                assert like(light.apply(asked), asked)
                light.on()
                good["apply"] += 1
            except DriverError:
                bad += 1
        try:
            light.apply(asked)
            light.on()
        except DriverError:  # what came late on the line is still to be heard
            light.apply(asked)
            light.on()
        with spoiled(line, clock, rng):
            for _ in range(5):
                try:
                    assert like(light.read(), asked)
                    assert light.is_on()
                    good["read"] += 1
                except DriverError:
                    bad += 1
        assert rig.states[-1].output
        assert rig.states[-1].frequency_hz == pytest.approx(asked.frequency_hz, rel=1e-4)
    assert min(good.values()) > 10
    assert bad > 0


def like(read: LightSettings, asked: LightSettings) -> bool:
    """Whether settings are those asked for, within what a strobe controller prints."""
    return (read.waveform, read.sync_output) == (asked.waveform, asked.sync_output) and all(
        getattr(read, name) == pytest.approx(getattr(asked, name), rel=1e-3, abs=1e-3)
        for name in ("frequency_hz", "duty_percent", "low_v", "high_v")
    )
