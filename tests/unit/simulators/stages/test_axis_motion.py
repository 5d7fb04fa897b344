"""The motion of an axis: ramps within their bounds, a load that settles, and a counter that can be wrong."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simulators.stages.axis_motion import Axis, Mechanics, MotionFault
from simulators.world.trajectory import SETTLED_DEG, ramp

SCALE = 6400.0
SPEED = 40.0 * SCALE
ACCELERATION = 200.0 * SCALE


def axis(**changes) -> Axis:
    settings = {"counts_per_deg": SCALE, "lowest_deg": -20.0, "highest_deg": 20.0} | changes
    return Axis(Mechanics(**settings))


def homed_axis(**changes) -> Axis:
    homed = axis(**changes)
    homed.home(0.0, SPEED, SPEED / 10, ACCELERATION)
    assert homed.referenced(10.0)
    return homed


numbers = st.floats(-1e5, 1e5, allow_nan=False)


@given(numbers, numbers, numbers, st.floats(1.0, 1e5), st.floats(1.0, 1e6))
@example(5e-324, 5e-324, 5e-324, 1.0, 2.0)
def test_a_ramp_ends_at_rest_on_its_target(position, velocity, target, speed, acceleration):
    p, v, scale = position, velocity, abs(position) + abs(target) + velocity**2 / acceleration + 1.0
    for leg in ramp(position, velocity, target, speed, acceleration):
        assert leg.duration_s > 0.0
        p += v * leg.duration_s + leg.acceleration * leg.duration_s**2 / 2.0
        v += leg.acceleration * leg.duration_s
    if target != position or velocity != 0.0:
        assert p == pytest.approx(target, abs=1e-9 * scale)
        assert v == pytest.approx(0.0, abs=1e-6 * (abs(velocity) + speed))


@given(numbers, numbers, st.floats(1.0, 1e5), st.floats(1.0, 1e6))
def test_a_ramp_from_rest_keeps_its_speed_and_acceleration(position, target, speed, acceleration):
    v = 0.0
    for leg in ramp(position, 0.0, target, speed, acceleration):
        assert abs(leg.acceleration) in (0.0, acceleration)
        v += leg.acceleration * leg.duration_s
        assert abs(v) <= speed * (1.0 + 1e-9)


def test_the_load_matches_a_step_by_step_integration():
    pan = homed_axis(settle_s=0.03)
    pan.move_to(2.0 * SCALE, 20.0, SPEED, ACCELERATION)
    pan.move_to(-1.0 * SCALE, 20.15, SPEED, ACCELERATION)
    dt, load = 2e-5, pan.pointing.angle_deg(20.0)
    for t in np.arange(20.0, 20.5, dt):
        load += dt / 0.03 * (pan.motor.position(t + dt / 2) / SCALE - load)
    assert pan.pointing.angle_deg(20.5) == pytest.approx(load, abs=1e-4)


def test_a_new_target_in_motion_is_reached_without_a_jump():
    pan = homed_axis()
    pan.move_to(10.0 * SCALE, 20.0, SPEED, ACCELERATION)
    before = pan.motor.position(20.1), pan.motor.velocity(20.1)
    pan.move_to(-5.0 * SCALE, 20.1, SPEED, ACCELERATION)
    assert (pan.motor.position(20.1), pan.motor.velocity(20.1)) == pytest.approx(before)
    assert pan.counter(22.0) == -5.0 * SCALE


def test_backlash_puts_the_load_behind_the_motor_on_the_side_it_came_from():
    pan = homed_axis(backlash_deg=0.02)
    pan.move_to(3.0 * SCALE, 20.0, SPEED, ACCELERATION)
    from_below = pan.pointing.angle_deg(25.0)
    pan.move_to(5.0 * SCALE, 25.0, SPEED, ACCELERATION)
    pan.move_to(3.0 * SCALE, 30.0, SPEED, ACCELERATION)
    assert from_below == pytest.approx(2.99)
    assert pan.pointing.angle_deg(35.0) == pytest.approx(3.01)


def test_a_settled_load_is_within_a_twentieth_of_an_arc_second():
    pan = homed_axis(settle_s=0.05)
    pan.move_to(1.0 * SCALE, 20.0, SPEED, ACCELERATION)
    settled = pan.pointing.settled_from_s
    assert 1.0 - pan.pointing.angle_deg(settled - 1e-6) == pytest.approx(SETTLED_DEG, rel=0.01)
    assert pan.pointing.angle_deg(settled) == 1.0


# ---------------------------------------------------------------- what can go wrong
def move_with(fault: MotionFault | None) -> Axis:
    """Move from 0 to 10 degrees, from second 20 on, with a fault; it takes 0.45 s."""
    pan = homed_axis()
    pan.arm(fault)
    pan.move_to(10.0 * SCALE, 20.0, SPEED, ACCELERATION)
    return pan


def test_a_slip_shows_in_the_encoder_only_and_stays_until_homing():
    pan = move_with(MotionFault("slip", share=0.5))
    assert pan.counter(30.0) == 10.0 * SCALE
    assert pan.encoder(30.0) == pytest.approx(5.0 * SCALE, abs=1.0)
    pan.move_to(0.0, 30.0, SPEED, ACCELERATION)
    assert pan.pointing.angle_deg(35.0) == pytest.approx(-5.0, abs=1e-3)
    pan.home(40.0, SPEED, SPEED / 10, ACCELERATION)
    assert pan.counter(50.0) == pan.encoder(50.0) == 0.0
    assert pan.pointing.angle_deg(50.0) == 0.0


def test_a_report_may_be_false_while_the_motion_is_not():
    pan = move_with(None)
    pan.report_false_idle(2)
    assert [pan.reports_busy(20.1) for _ in range(3)] == [False, False, True]
    pan.stuck_busy = True
    assert pan.reports_busy(30.0)
    assert not pan.busy(30.0)
