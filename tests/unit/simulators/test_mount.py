"""The mount's own motion: it vibrates with its amplitude and frequency, and drifts at its rate."""

import numpy as np
import pytest

from simulators.config import bench_config
from simulators.errors import ConfigError
from simulators.pixels.biases import FACTORY
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.mount import STEP_ARCSEC, drift_since_on_arcsec, true_angles_deg
from simulators.world.truth import NOISE_LEVELS, CameraTruth, MountTruth, Truth
from simulators.world.world import LightState, World

POSE = {"pan": 1.0, "tilt": -2.0, "roll": 3.0}
STILL = (0.0, 0.0)


def at(mount, t_s, crept=STILL, phases=STILL):
    """Departure from the pose, arc seconds."""
    angles = true_angles_deg(POSE, mount, crept, phases, t_s)
    return np.array([(angles[n] - POSE[n]) * 3600.0 for n in ("pan", "tilt", "roll")])


def test_vibration_has_its_amplitude_and_frequency():
    mount = MountTruth(vibration_arcsec=4.0, vibration_hz=25.0)
    times = np.arange(0.0, 0.4, 0.001)
    course = np.array([at(mount, t, phases=(0.0, 0.3)) for t in times])
    assert course[:, :2].max(axis=0) == pytest.approx([4.0, 4.0], rel=1e-2)
    assert np.ptp(course[:, 2]) == 0.0
    spectrum = np.abs(np.fft.rfft(course[:, 0]))
    assert np.fft.rfftfreq(times.size, 0.001)[spectrum.argmax()] == pytest.approx(25.0)
    np.testing.assert_allclose(
        at(mount, 0.04, phases=(0.1, 0.2)), at(mount, 0.0, phases=(0.1, 0.2)), atol=1e-9
    )


def test_drift_goes_on_from_recording_to_recording():
    mount = MountTruth(drift_arcsec_per_min=(6.0, -3.0))
    crept = drift_since_on_arcsec(mount, 90.0)
    assert crept == pytest.approx((9.0, -4.5), abs=STEP_ARCSEC / 2)
    np.testing.assert_allclose(at(mount, 10.0, crept), [10.0, -5.0, 0.0], atol=1e-9)


def test_both_are_set_in_the_simulation_section_of_a_station():
    section = {"vibration_arcsec": 5, "vibration_hz": 40, "drift_arcsec_per_min": [2, -1]}
    assert bench_config({"mount": section}).truth.mount == MountTruth(5.0, 40.0, (2.0, -1.0))
    with pytest.raises(ConfigError) as error:
        bench_config({"mount": {"vibration_hz": -1}})
    assert error.value.where == "mount.vibration_hz"


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


def test_a_creeping_recording_is_the_same_only_where_it_has_crept_to():
    creeping = MountTruth(drift_arcsec_per_min=(60.0, 0.0))
    assert stream(creeping, 3.0) == stream(creeping, 3.01)
    assert stream(creeping, 3.0) != stream(creeping, 33.0)
