"""Station files: what they may name, what is refused, and what the shipped ones say."""

import re
from pathlib import Path

import pytest
from filled_stations import filled_example
from refusals import faults_of
from station_texts import PLAIN, document_of, station_of

from bench.stations.stages_and_lights import ScpiLightConfig
from bench.stations.station import SHIPPED_STATIONS, load_station
from drivers.light import LightSettings
from sequences.script import Flicker


def faults(text: str) -> list[str]:
    return faults_of(document_of, text)


def changed(old: str, new: str) -> str:
    assert old in PLAIN
    return PLAIN.replace(old, new)


def with_stage(stage: str) -> str:
    begin, end = PLAIN.index("stage:\n"), PLAIN.index("light:\n")
    return PLAIN[:begin] + f"stage: {stage}\n" + PLAIN[end:]


def test_every_shipped_station_reads_without_a_fault():
    shipped = sorted(path.stem for path in SHIPPED_STATIONS.glob("*.yaml"))
    examples = ["example_evk4", "example_network", "example_thorlabs", "example_turntable"]
    simulated = ["simulated", "simulated_frames", "simulated_ideal", "simulated_unaligned"]
    assert shipped == [*examples, *simulated]
    assert [load_station(name).value.is_simulated for name in shipped] == [False] * 4 + [True] * 4


SCALE = "microsteps_per_deg: 6400\n      limits_deg: [-15"


@pytest.mark.parametrize(
    ("old", "new", "place", "fact"),
    [
        ("driver: scpi", "driver: scpy", "light.driver", "'scpi', 'gardasoft', 'text' (got 'scpy')"),
        ("sim:light", "sim:lamp", "light.port", "sim:gimbal, sim:gimbal-pan"),
        ("    pan:", "    yaw:", "stage.axes.yaw", "'pan', 'tilt' or 'roll' (got 'yaw')"),
        ("[-15, 15]", "[15, -15]", "stage.axes.pan.limits_deg", "lower limit"),
        ("[-15, 15]", "[5, 15]", "stage.axes.pan.limits_deg", "0 degrees"),
        ("device: 2", "device: 1", "stage.axes", "same device and axis"),
        (SCALE, SCALE.replace("6400", "0"), "stage.axes.pan.microsteps_per_deg", "scale of 0"),
        ("high_v: 5", "high_v: 0", "light", "low_v must be below high_v"),
        ("serial: SG0042", "frequency_range_hz: [9, 3]", "light", "frequency_range_hz must be [lowest,"),
        ("lens: ", "biases: {bias_fo: 3000}\n  lens: ", "camera.biases.bias_fo", "2047 or less (got '3000')"),
        ("lens: ", "biases: {bias_diff: 1}\n  lens: ", "camera.biases.bias_diff", "'bias_diff_on'"),
        ("sim:light", "spy:///dev/null?file=notes.txt", "light.port", "kind spy://"),
        ("speed_deg_s: 40", "speed_deg_s: 1e-300", "speed_deg_s", "0.001 to 1000 deg/s (got '1e-300')"),
    ],
    ids=lambda text: text[:25].strip(),
)  # fmt: skip
def test_what_makes_no_sense_is_refused_with_what_would(old, new, place, fact):
    messages = faults(changed(old, new))
    assert any(f"{place}: " in line and fact in line for line in messages), messages


@pytest.mark.parametrize(
    ("target", "fact"),
    [
        ("{segments: 6}", "6 segments"),
        ("stars on chrome", "target: {description: ...}"),
        ("{tag_family: 36h12}", "36h11, 36h10, 25h9, 16h5"),
        ("{drawing: {size_mm: [200, 300]}}", "drawing.size_mm must be at least [200.694, 289]"),
        ("{squares: [1000000, 1000000]}", "target.squares[0]: must be from 2 to 10000 (got '1000000')."),
        ("{squares: [1000, 1000]}", "1000 x 1000 squares are more than 200000"),
    ],
)
def test_a_target_that_cannot_be_is_refused(target, fact):
    messages = faults(changed("simulation: {}", f"target: {target}\nsimulation: {{}}"))
    assert any(": target" in line and fact in line for line in messages), messages


def test_simulated_ports_are_refused_where_nothing_is_simulated():
    messages = faults(changed("simulation: {}\n", ""))
    assert [line.split(": ")[1] for line in messages] == ["stage.port", "light.port", "camera.address"]
    assert all("(simulation: {} is enough)" in line for line in messages)


@pytest.mark.parametrize(
    ("stage", "fault"),
    [
        ("{driver: esp, port: a}", "stage.driver: must be one of 'zaber_ascii', 'ximc', 'grbl', 'esp30x', 'thorlabs_apt', 'text' (got 'esp')."),
        ("{driver: grbl, port: a, axes: {pan: {letter: Q}}}", "stage.axes.pan.letter: must be 'X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V' or 'W'"),
        ("{driver: thorlabs_apt, axes: {pan: {counts_per_deg: 0}}}", "stage.axes.pan.counts_per_deg: a scale of 0 moves nothing."),
        ("{driver: dynamixel, port: a, axes: {pan: {id: 1}}}", "stage: the driver 'dynamixel' was taken out, because a servo's step of 0.088 degrees is too coarse to calibrate a camera. Use another stage."),
    ],
)  # fmt: skip
def test_other_stages_are_checked_in_their_own_terms(stage, fault):
    messages = faults(with_stage(stage))
    assert any(fault in line for line in messages), messages


MOTION = "limits_deg: [-1, 1], speed_deg_s: 1, acceleration_deg_s2: 1"


@pytest.mark.parametrize(
    ("driver", "axis", "shared"),
    [
        ("ximc", "port: a, serial: b, steps_per_deg: 1", "port"),
        ("esp30x, port: a", "number: 1, serial: b", "number"),
        ("grbl, port: a, serial: b", "letter: X, steps_per_deg: 1", "letter"),
        ("thorlabs_apt", "port: a, serial: b, counts_per_deg: 1", "port"),
    ],
)
def test_two_axes_must_differ_in_what_tells_them_apart(driver, axis, shared):
    both = f"{{pan: {{{axis}, {MOTION}}}, tilt: {{{axis}, {MOTION}}}}}"
    (message,) = faults(with_stage(f"{{driver: {driver}, axes: {both}}}"))
    assert re.search(f"stage.axes: .* {shared}", message)


def test_a_run_with_the_simulated_camera_of_another_process_counts_as_simulated():
    text = changed("simulation: {}\n", "")
    for port, elsewhere in (("gimbal", "/dev/a"), ("light", "/dev/b"), ("camera", "127.0.0.1:5")):
        text = text.replace(f"sim:{port}", elsewhere)
    assert station_of(text).is_simulated


def test_the_simulation_section_has_the_values_json_would_have_but_serial_numbers_stay_text():
    section = "simulation: {camera_serial: 123, camera: {fx: 3e3, k1: .06}, a: [true, 5, '6'], b: null, c: 007, d: NaN, e: 1e999, f: -2}"
    station = station_of(changed("simulation: {}", section))
    assert station.simulation == {
        "camera_serial": "123",
        "camera": {"fx": 3000.0, "k1": 0.06},
        "a": [True, 5, 6],
        "b": None,
        "c": "007",
        "d": "NaN",
        "e": "1e999",
        "f": -2,
    }


def test_a_level_is_a_share_of_what_the_station_s_light_may_do():
    light = ScpiLightConfig(driver="scpi", port="x", low_v=1, high_v=3)
    settings = light.settings(Flicker("sine", 80, 50, level_percent=25))
    assert settings == LightSettings("sine", 80, 50, low_v=1, high_v=1.5, sync_output=True)


def test_the_simulated_bench_is_told_the_station_s_own_target():
    text = changed(
        "simulation: {}",
        "target: {tag_family: tag25h9, polarity: negative}\nsimulation: {reticle: {bow_mm: 1}}",
    )
    world = station_of(text).simulated_world
    assert world["target"]["tag_family"] == "25h9"
    assert world["target"]["squares"] == [50, 72]
    assert world["reticle"] == {"polarity": "negative", "bow_mm": 1}


@pytest.mark.parametrize("page", ["thorlabs"])
def test_the_section_on_the_page_of_a_device_is_read_without_a_fault(page):
    text = (Path(__file__).parents[4] / "docs" / "devices" / f"{page}.md").read_text(encoding="utf-8")
    section = re.search(r"```yaml\n(stage:.*?)```", text, re.DOTALL)
    example = filled_example("example_evk4")
    before, rest = example.split("stage:\n")
    station = station_of(before + section[1] + "\nlight:\n" + rest.split("light:\n")[1])
    assert station.stage.axes["pan"].counts_per_deg > 0
