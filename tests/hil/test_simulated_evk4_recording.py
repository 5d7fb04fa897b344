"""Recordings of the simulated EVK4, made by the driver over its socket."""

import itertools
from contextlib import closing, contextmanager
from datetime import UTC, datetime

import numpy as np
import pytest

from bench.measure.measure import measure
from calib.target import StarTarget
from drivers.camera import CameraSettings
from drivers.camera.raw_file import RawFile
from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from simulators.cameras.evk4 import SimulatedEvk4
from simulators.world.truth_config import truth_from_config
from simulators.world.world import LightState, World

NOW = datetime(2026, 11, 20, tzinfo=UTC)
SETTINGS = CameraSettings({"bias_diff_on": 5})
FLICKER = LightState(output=True, sync=True)


@contextmanager
def bench(light=FLICKER, settings=SETTINGS, clock=None):
    """A driver connected to a simulated camera under that light, with these settings."""
    world = World(truth_from_config({}), seed=1)
    world.set_light(light)
    with closing(SimulatedEvk4(world, paced=False)) as simulated:
        simulated.start()
        camera = SimulatedEvk4Camera.open(
            simulated.address, serial="00050423", clock=clock or SystemClock(), utc_now=lambda: NOW
        )
        camera.simulated = simulated
        with closing(camera):
            camera.apply(settings)
            yield camera


def test_the_lights_edges_arrive_as_triggers_a_half_period_apart(tmp_path):
    with bench() as camera:
        camera.record(tmp_path / "pose.raw", 0.035)
    triggers = RawFile.open(tmp_path / "pose.raw").triggers()
    assert len(triggers.t) >= 4
    assert np.diff(triggers.t) == pytest.approx(1e6 / 120, abs=2)
    assert set(np.diff(triggers.value.astype(int))) == {-1, 1}


class LateClock(SystemClock):
    """The clock of a busy computer: each sleep takes longer."""

    def sleep(self, duration_s):
        super().sleep(duration_s + 0.002)


def test_equal_runs_give_the_same_files_however_late_they_are_stopped(tmp_path):
    def files(name, clock):
        with bench(clock=clock) as camera:
            paths = [tmp_path / f"{name}-{k}.raw" for k in range(3)]
            for path, duration_s in zip(paths, (0.03, 0.01, 0.01), strict=True):
                camera.record(path, duration_s)
        return paths

    punctual, late = files("punctual", SystemClock()), files("late", LateClock())
    assert [path.read_bytes() for path in punctual] == [path.read_bytes() for path in late]
    spans = [(scan.first_t_us, scan.last_t_us) for scan in (RawFile.open(path).scan() for path in late)]
    assert [first for first, _ in spans] == [0, 102_400, 204_800]
    assert all(last < first for (_, last), (first, _) in itertools.pairwise(spans))


def test_a_recording_over_the_wrap_of_the_clock_is_read_as_any_other(tmp_path):
    def recorded_at(clock_us):
        path = tmp_path / f"{clock_us}.raw"
        with bench() as camera:
            camera.simulated.time_base.now_us = clock_us
            facts = camera.record(path, 0.04)
        return facts, *RawFile.open(path).read(), measured(path)

    before_us = 819 * 102_400  # 20 ms before the fifth wrap
    wrapped_us = before_us % (1 << 24)
    facts, events, triggers, measurement = recorded_at(0)
    later_facts, later, later_triggers, later_found = recorded_at(before_us - 1)
    assert later.t[0] < 1 << 24 < later.t[-1]
    assert (np.diff(later.t) >= 0).all()
    assert later_facts == facts
    np.testing.assert_array_equal(later.t - wrapped_us, events.t)
    np.testing.assert_array_equal(later_triggers.t - wrapped_us, triggers.t)
    # to the last digit: a run that was interrupted ends as one that was not, whatever the clock said
    assert np.array_equal(later_found.view.points_px, measurement.view.points_px)
    begin_us, end_us = measurement.facts["image"].pop("window_us")
    assert later_found.facts["image"].pop("window_us") == [wrapped_us + begin_us, wrapped_us + end_us]
    assert later_found.facts == measurement.facts


def measured(path):
    return measure(path, name="p", target=StarTarget(), image="auto", periods=None, expected_hz=60.0)


def test_without_trigger_input_there_are_no_triggers(tmp_path):
    with bench(LightState(output=False, sync=True), CameraSettings(trigger_in=False)) as camera:
        assert camera.record(tmp_path / "pose.raw", 0.01).triggers == 0


def test_an_overflow_shows_in_the_counters_until_it_is_cleared(tmp_path):
    with bench() as camera:
        camera.simulated.stream_faults.overflows = True
        spoilt = camera.record(tmp_path / "spoilt.raw", 0.020)
        camera.simulated.stream_faults.clear()
        good = camera.record(tmp_path / "good.raw", 0.020)
    assert spoilt.rate_controller_out < 0.9 * spoilt.rate_controller_in
    assert good.rate_controller_out == good.rate_controller_in
