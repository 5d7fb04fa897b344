"""A wrong configuration of the simulated bench names its key, and says what is wrong with it."""

import pytest
import yaml

from simulators.config import bench_config
from simulators.errors import ConfigError

WRONG = """
camera: {fx: wide} -> camera.fx
camera: {fz: 1} -> camera.fz
camera: {width: 12.5} -> camera.width
camera: 5 -> camera
camera: {projection: mirror} -> camera.projection
camera: {projection: fisheye, p1: 0.1} -> camera.p1
camera_seed: null -> camera_seed
collimator: {r: .nan} -> collimator.r
faults: {} -> faults
faults: [{device: pan, fault: hiccup}] -> faults[0].fault
gimbal: {wobble_deg: -0.1} -> gimbal.wobble_deg
gimbal: {scale: 1.001} -> gimbal.scale.pan
gimbal: {scale: {yaw: 0.1}} -> gimbal.scale.yaw
gimbal: {backlash_deg: {roll: -0.1}} -> gimbal.backlash_deg.roll
gimbal: {nonorthogonality_deg: .inf} -> gimbal.nonorthogonality_deg
gimbal: {camera_on_head_deg: 3} -> gimbal.camera_on_head_deg
lens: {focus_distance_m: 0.1} -> lens.focus_distance_m -> at least 0.2
lens: {focus_distance_m: -1.0} -> lens.focus_distance_m -> Beyond infinity
lens: {focus_distance_m: far} -> lens.focus_distance_m -> infinity
lens: {f_number: 0.5} -> lens.f_number -> from 1 to 32
lens: {pixel_um: -4.86} -> lens.pixel_um -> not positive
lens: {pixel_um: 60} -> lens.pixel_um -> at most 100 mm
lens: {focus: 1} -> lens.focus -> focus_distance_m
light: {kind: candle} -> light.kind
mount: {vibration_hz: -1} -> mount.vibration_hz
mount: {shift_mm: 3} -> mount.shift_mm
noise: loud -> noise
optics: {mounting_deg: [1, 2]} -> optics.mounting_deg
paced: "yes" -> paced
ports: usb -> ports
stage: {left_behind: CV} -> stage.left_behind -> list of texts
stage: {kind: ximc, left_behind: [home]} -> stage.left_behind -> hexadecimal
reticle: {bow_radius_mm: 0} -> reticle.bow_radius_mm
reticle: {polarity: both} -> reticle.polarity -> Unknown polarity 'both'
stag: {} -> stag
stage: {yaw: {}} -> stage.yaw
stage: {pan: {limit_deg: -5}} -> stage.pan.limit_deg
stage: {pan: {start_deg: 50}} -> stage.pan.start_deg
stage: {pan: {microsteps_per_deg: 1.5}} -> stage.pan.microsteps_per_deg
stage: {kind: hand} -> stage.kind
stage: {kind: ximc, pan: {serial: A1}} -> stage.pan.serial
stage: {pan: {backlash_deg: 0.03}}, gimbal: {backlash_deg: 0.01} -> stage.pan.backlash_deg
target: {pitch: 4} -> target.pitch -> Unknown key
target: {squares: [3]} -> target.squares -> 2 numbers are expected
target: {tag_id: 999} -> target -> No such target can be printed: .* has tags 0 to 586
"""
"""A line each: the sections, the key that is named and, where it matters, what is said of it."""


@pytest.mark.parametrize("line", WRONG.strip().splitlines())
def test_a_wrong_configuration_names_its_key(line):
    sections, where, *message = line.split(" -> ")
    with pytest.raises(ConfigError, match=message[0] if message else None) as error:
        bench_config(yaml.safe_load(f"{{{sections}}}"))
    assert error.value.where == where


def test_naming_one_axis_leaves_the_others():
    def serials(**stage):
        return [(name, axis.serial) for name, axis in bench_config({"stage": stage}).axes.items()]

    both = [("pan", "100101"), ("tilt", "100102")]
    assert serials() == serials(pan={}) == serials(tilt={"limit_deg": 5}) == both
    assert bench_config({"stage": {"tilt": {"limit_deg": 5}}}).axes["tilt"].limit_deg == 5.0
    assert serials(roll={}) == [*both, ("roll", "100103")]
    assert serials(tilt={}, pan={}) == both[::-1]
