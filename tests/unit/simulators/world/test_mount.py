"""The mount: it vibrates with its amplitude and frequency, drifts at its rate, and can be shifted across the beam."""

from dataclasses import replace

import numpy as np
import pytest
from apparent import apparent_points
from hypothesis import given
from hypothesis import strategies as st

from simulators.optics.collimator_errors import disc_of
from simulators.optics.picture import beam_of, project, projection_of, true_rotation
from simulators.pixels.biases import FACTORY
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.drift import STEP_ARCSEC, drift_since_on_arcsec, moved_angles_deg
from simulators.world.truth import NOISE_LEVELS, CameraTruth, CollimatorTruth, MountTruth, OpticsTruth, Truth
from simulators.world.world import LightState, World

POSE = {"pan": 1.0, "tilt": -2.0, "roll": 3.0}
STILL = (0.0, 0.0)


def at(mount, t_s, crept=STILL, phases=STILL):
    """Departure from the pose, arc seconds."""
    angles = moved_angles_deg(POSE, mount, crept, phases, t_s)
    return np.array([(angles[n] - POSE[n]) * 3600.0 for n in ("pan", "tilt", "roll")])


def test_vibration_has_its_amplitude_and_frequency():
    mount = MountTruth(vibration_arcsec=4.0, vibration_hz=25.0)
    times = np.arange(0.0, 0.4, 0.001)
    course = np.array([at(mount, t, phases=(0.0, 0.3)) for t in times])
    assert course[:, :2].max(axis=0) == pytest.approx([4.0, 4.0], rel=1e-2)
    assert np.ptp(course[:, 2]) == 0.0
    spectrum = np.abs(np.fft.rfft(course[:, 0]))
    assert np.fft.rfftfreq(times.size, 0.001)[spectrum.argmax()] == pytest.approx(25.0)
    breathing, held = (at(mount, t, phases=(0.1, 0.2)) for t in (0.04, 0.0))
    np.testing.assert_allclose(breathing, held, atol=1e-9)


def test_drift_goes_on_from_recording_to_recording():
    mount = MountTruth(drift_arcsec_per_min=(6.0, -3.0))
    crept = drift_since_on_arcsec(mount, 90.0)
    assert crept == pytest.approx((9.0, -4.5), abs=STEP_ARCSEC / 2)
    np.testing.assert_allclose(at(mount, 10.0, crept), [10.0, -5.0, 0.0], atol=1e-9)


def stream(mount, asked_s):
    """Words of the first 20 ms of a recording that is asked for at a time."""
    truth = Truth(
        camera=CameraTruth(fx=330.0, fy=331.0, cx=65.0, cy=34.0, width=128, height=72),
        noise=NOISE_LEVELS["clean"],
        mount=mount,
    )
    now = [0.0]
    world = World(truth, clock=lambda: now[0])
    world.set_light(LightState(output=True))
    now[0] = asked_s
    taken = SensorStream(world, CameraState(dict(FACTORY)), {})
    return b"".join(taken.next_frame() for _ in range(10))


def test_a_shaken_recording_is_the_same_whenever_it_is_taken():
    shaken = MountTruth(vibration_arcsec=200.0)
    assert stream(shaken, 3.0) == stream(shaken, 17.123)
    assert stream(shaken, 3.0) != stream(MountTruth(), 3.0)


SHIFT = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


@given(SHIFT, st.floats(-0.2, 0.2), st.floats(-15.0, 15.0))
def test_a_shifted_camera_sees_the_pattern_move_by_defocus_times_shift_over_r(shift_mm, defocus, pan):
    truth = Truth(collimator=CollimatorTruth(defocus=defocus))
    shifted = replace(truth, mount=MountTruth(shift_mm=shift_mm))
    rotation = true_rotation({"pan": pan}, truth)
    c = truth.collimator
    points = np.array([[c.x, c.y], [c.x + 30.0, c.y - 20.0]])
    still, moved = (apparent_points(points, projection_of(t, rotation).aberrations) for t in (truth, shifted))
    # defocus > 0: the pattern moves against the camera's shift, as that of a near target does
    np.testing.assert_allclose((moved - still) / c.r, [-defocus * np.array(shift_mm) / c.r] * 2, atol=1e-12)
    discs = [np.array(disc_of(beam_of(t), rotation)[:3]) for t in (truth, shifted)]
    np.testing.assert_allclose(discs[1] - discs[0], [-shift_mm[0], -shift_mm[1], 0.0], atol=1e-12)


def test_a_pupil_in_front_of_the_pivot_acts_as_a_shift_of_the_camera():
    tangent = np.tan(np.radians(5.0))
    level = OpticsTruth(mounting_deg=(0.0, 0.0, 0.0))
    walking = Truth(collimator=CollimatorTruth(defocus=0.066, disc_walk=(-2.0, -2.0)), optics=level)
    rotation = true_rotation({"pan": 5.0}, walking)
    axis = rotation[2, 0] / rotation[2, 2]
    assert abs(axis) == pytest.approx(tangent)
    mount = MountTruth(shift_mm=(2.0 * axis, 0.0))
    shifted = Truth(collimator=CollimatorTruth(defocus=0.066), optics=level, mount=mount)
    points = np.array([[100.0, 140.0], [80.0, 150.0]])
    walks, moves = (project(points, rotation, truth) for truth in (walking, shifted))
    np.testing.assert_allclose(walks, moves, atol=1e-9)


def test_the_world_remembers_where_the_camera_stood():
    now = [10.0]
    world = World(Truth(mount=MountTruth(shift_mm=(1.0, 0.0))), clock=lambda: now[0])
    world.change_setup(lambda setup: replace(setup, shift_mm=(2.0, -1.0)), since_s=5.0)
    assert [world.camera_setup(t).shift_mm for t in (4.9, 5.0)] == [(1.0, 0.0), (2.0, -1.0)]
    assert world.truth_at(6.0).mount.shift_mm == (2.0, -1.0)
    assert world.truth_at(4.0) is world.truth
