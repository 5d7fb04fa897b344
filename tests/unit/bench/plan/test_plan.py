"""Plans: times, disk, how long to record, and every fault of a script on a station at its place."""

import json
import re
from pathlib import Path

import pytest
from filled_stations import filled_example
from hypothesis import event, given, settings
from hypothesis import strategies as st
from station_texts import IDEAL, PLAIN, document_of

from bench.base.errors import ScriptError
from bench.measure.camera_kinds import periods_in_window, recording_duration_s
from bench.plan.plan import POSE_BYTES, REPORT_BYTES, load_documents, make_plan
from bench.stations.station import SHIPPED_STATIONS
from bench.wording.plan_text import render_plan
from drivers.stage.motion import travel_time_s
from sequences.errors import DocumentFaults
from sequences.reader import check_document
from sequences.schema import Sequence

SEQUENCES = sorted((Path(__file__).parents[4] / "sequences").glob("*.yaml"))
STATION = document_of(PLAIN)
HEAD = "format: starbench/sequence/1\nname: test\n"


def planned(text: str, station=STATION):
    return make_plan(check_document((HEAD + text).encode(), "s.yaml", Sequence), station)


def faults(text: str, station=STATION) -> list[str]:
    return [str(fault) for fault in planned(text, station).faults]


def station_with(old: str, new: str):
    assert old in PLAIN
    return document_of(PLAIN.replace(old, new))


def as_filled_in(station: str, folder: Path) -> str:
    """Return the name of a station, or the path of an example after it was filled in."""
    if not station.startswith("example"):
        return station
    path = folder / "bench.yaml"
    path.write_text(filled_example(station), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("station", "missing"),
    [("example_evk4", 10), ("example_network", 8), ("example_turntable", 6), ("example_thorlabs", 11)],
)
def test_an_example_is_refused_until_it_is_filled_in_and_then_runs(station, missing, tmp_path):
    made = make_plan(*load_documents("turntable", station))
    assert len(made.faults) == missing
    assert all("(placeholder" in fault.message for fault in made.faults)
    filled = make_plan(*load_documents("turntable", as_filled_in(station, tmp_path)))
    assert (filled.faults, filled.remarks) == ((), ())
    assert len(filled.poses) == 7


GOOD = "steps: [light, {move: {pan_deg: 1}}, settle, record, {move: {pan_deg: 2}}, settle, record, solve, report]\n"


@pytest.mark.parametrize("path", SEQUENCES, ids=lambda path: path.stem)
@pytest.mark.parametrize("station", ["simulated", "simulated_unaligned", "example_evk4"])
def test_every_shipped_sequence_runs_on_every_shipped_station(path, station, tmp_path):
    made = make_plan(*load_documents(path.stem, as_filled_in(station, tmp_path)))
    if path.stem == "parallax_test" and "example" in station:  # the rim is out of reach of this stage
        assert all("outside the limits" in fault.message for fault in made.faults)
        assert len(made.faults) > 0
        return
    assert (made.faults, made.remarks) == ((), ())
    counts = {"three_pose": 3, "nine_pose": 9, "turntable": 7, "until_good": 3, "parallax_test": 15}
    assert len(made.poses) == counts[path.stem]


@given(st.floats(0.1, 10_000), st.floats(0.1, 1000))
def test_a_recording_holds_its_whole_periods_wherever_the_light_stands(window_ms, frequency_hz):
    periods = periods_in_window(window_ms, frequency_hz)
    duration_s = recording_duration_s(window_ms, frequency_hz)
    assert periods >= 1
    assert abs(periods - window_ms * 1e-3 * frequency_hz) <= max(0.5, 1 - window_ms * 1e-3 * frequency_hz)
    worst_wait_s = 1 / frequency_hz  # the recording begins just after an edge
    assert duration_s >= worst_wait_s + periods / frequency_hz
    assert duration_s < worst_wait_s + (periods + 1) / frequency_hz + 0.01


def test_the_time_of_a_plan_is_the_sum_of_its_steps_and_moves_count_from_where_the_stage_stands():
    made = planned(
        "steps: [light, {move: {pan_deg: 10}}, {settle: {duration_s: 2}}, record, {move: {pan_deg: 10, tilt_deg: 1}},"
        " {wait: {duration_s: 100}}, record, {prompt: {text: x, timeout_s: 30}}, solve, report]\n"
    )
    took = {step.step.number: step.duration_s for step in made.steps}
    assert took[2] == pytest.approx(travel_time_s(10, 40, 200), abs=0.2)
    assert took[3] == 2
    assert took[5] == pytest.approx(travel_time_s(1, 40, 200), abs=0.2)  # tilt alone: pan is there already
    assert (took[6], took[8]) == (100, 30)
    done = [step.done_after_s for step in made.steps]
    homing_s = done[0] - took[1]
    parking_s = done[7] - took[8] - done[6]
    assert homing_s > travel_time_s(30, 40, 200)  # over pan's whole range
    assert parking_s == pytest.approx(travel_time_s(10, 40, 200), abs=0.2)  # the last pose is at pan 10
    assert made.duration_s == done[-1] == pytest.approx(sum(took.values()) + homing_s + parking_s)


def test_disk_is_counted_for_every_pose_and_every_attempt():
    once = planned(GOOD)
    more = planned("defaults: {record: {attempts: 4}}\n" + GOOD)
    longer = planned("defaults: {record: {window_ms: 330}}\n" + GOOD)
    fixed = REPORT_BYTES + 2 * POSE_BYTES
    assert more.size_bytes == once.size_bytes
    assert more.most_bytes - fixed == 2 * (once.most_bytes - fixed)
    assert longer.size_bytes > once.size_bytes > fixed


@pytest.mark.parametrize(
    ("before", "after", "place", "fact"),
    [
        ("", "{move: {pan_deg: 16}}", "move.pan_deg", "-15 to 15 deg"),
        ("", "{move: {roll_deg: 1}}", "move.roll_deg", "no roll axis; it has pan, tilt"),
        ("", "{light: {frequency_hz: 20000}}", "light.frequency_hz", "0.1 to 10000 Hz"),
        ("", "{record: {window_ms: 10}}", "window_ms", "at least 16.67 ms"),
        ("{light: off}", "", "steps[6].record", "in the dark"),
        ("solve", "", "steps[1].solve", "no pose"),
        ("report", "", "steps[1].report", "no solve"),
        ("report", "", "steps[2].move", "no step may follow"),
    ],
)
def test_a_step_that_cannot_be_done_on_the_station_is_a_fault_at_its_place(before, after, place, fact):
    steps = [
        "light", before, "{move: {pan_deg: 1}}", "settle", "record", "{move: {pan_deg: 2}}", "record", after,
        "solve", "report",
    ]  # fmt: skip
    messages = faults(f"steps: [{', '.join(filter(None, steps))}]\n")
    assert any(f"{place}: " in line and fact in line for line in messages), messages


@pytest.mark.parametrize(
    ("recorded", "fault"),
    [
        ("{until: {expanded_fx_px: 2, at_most: 2, start: {pan_deg: [1, 2, 3]}}}", "at_most (2)"),
        ("{repeat: {poses: these, steps: [move, settle, record]}}", "'these'"),
        ("record", "before any move"),
    ],
)
def test_steps_left_out_because_of_a_fault_give_no_second_fault(recorded, fault):
    (message,) = faults(f"steps: [light, {recorded}, {{light: off}}, solve, report]\n")
    assert fault in message


def test_two_directions_are_the_fewest_and_the_same_one_twice_is_one():
    text = "steps: [light, {move: {pan_deg: 1}}, settle, record, {move: {pan_deg: PAN}}, settle, record, solve, report]\n"
    assert faults(text.replace("PAN", "2")) == []
    (fault,) = faults(text.replace("PAN", "1"))
    assert fault.startswith("s.yaml:3:92: steps[7].solve: ")


def places(messages):
    """File, line and column of each fault, and its path."""
    return [": ".join(line.split(": ")[:2]) for line in messages]


def test_a_setting_of_the_defaults_is_blamed_where_it_is_written():
    messages = faults("defaults:\n  light: {frequency_hz: 20000}\n  record: {window_ms: 0.01}\n" + GOOD)
    assert places(messages) == [
        "s.yaml:4:25: defaults.light.frequency_hz", "s.yaml:5:23: defaults.record.window_ms",
    ]  # fmt: skip
    assert "at least 0.05 ms" in messages[1]  # of the other setting's frequency


def test_the_limits_themselves_are_within_and_a_hair_short_of_a_period_still_counts_as_one():
    text = GOOD.replace("pan_deg: 1}", "pan_deg: 15}").replace("pan_deg: 2}", "pan_deg: -15}")
    assert faults("defaults: {record: {window_ms: 16.6}}\n" + text) == []


def test_a_turntable_runs_what_is_written_for_one_axis_and_nothing_else():
    begin, end = PLAIN.index("    tilt:"), PLAIN.index("light:\n")
    turntable = document_of(PLAIN[:begin] + PLAIN[end:])
    faults_of = {
        path.stem: make_plan(load_documents(path.stem, "simulated")[0], turntable).faults
        for path in SEQUENCES
    }
    assert faults_of["turntable"] == ()
    places = {fault.path for fault in faults_of["three_pose"]}
    assert places == {f"poses.three[{i}].tilt_deg" for i in range(3)}


def test_a_grid_outside_the_limits_is_blamed_at_the_angles_it_is_made_of():
    grid = "{pan_deg: {first: -16, last: 3, count: 9}, tilt_deg: [0, 11]}"
    assert places(
        faults(f"steps: [light, {{repeat: {{poses: {grid}, steps: [move, settle, record]}}}}, solve, report]\n")
    ) == [
        "s.yaml:3:51: steps[1].repeat.poses.pan_deg.first", "s.yaml:3:90: steps[1].repeat.poses.tilt_deg[1]",
    ]  # fmt: skip


def test_a_limit_on_what_is_not_estimated_is_blamed():
    solve = "{solve: {model: planar, distortion: [k1], limits: {rms_px: 1, sigma_k1: 1, sigma_k2: 1, sigma_r_mm: 1}}}"
    messages = faults(GOOD.replace("solve", solve))
    assert [line.split(": ")[1] for line in messages] == [
        "steps[7].solve.limits.sigma_k2",
        "steps[7].solve.limits.sigma_r_mm",
    ]
    assert faults(GOOD.replace("solve", "{solve: {limits: {sigma_k2: 1, sigma_r_mm: 1}}}")) == []


def test_triggers_cannot_be_required_of_a_light_that_gives_none():
    station = station_with("high_v: 5", "sync_output: false")
    (fault, again) = faults(GOOD, station)
    assert "sync triggers are required" in fault
    assert "sync triggers are required" in again
    relaxed = "defaults: {record: {gates: {require_triggers: false}}}\n"
    assert faults(relaxed + GOOD, station) == []


def test_what_somebody_should_know_is_said_and_forbids_nothing():
    made = planned("steps: [light, {move: {pan_deg: 1}}, record, {move: {pan_deg: 2}}, settle, record, solve, {move: {pan_deg: 3}}, settle, record]\n")  # fmt: skip
    assert made.faults == ()
    facts = ("no report step", "directly after a move", "after the last solve")
    assert [fact in remark.message for fact, remark in zip(facts, made.remarks, strict=True)] == [True] * 3


@pytest.mark.parametrize(("written", "remarked"), [("duty_percent: 0.5", ["0.5"]), ("duty_percent: 20", [])])
def test_a_share_in_place_of_per_cent_is_remarked(written, remarked):
    remarks = planned(f"defaults: {{light: {{{written}}}}}\n{GOOD}").remarks
    assert [remark.message.split(" means ")[0] for remark in remarks] == remarked


def test_a_pose_that_looks_past_the_beam_is_remarked_and_drawn_outside_of_it():
    made = planned(GOOD.replace("pan_deg: 2", "pan_deg: -14.5"))
    (remark,) = made.remarks
    assert "pose 2" in remark.message
    assert "14.5 degrees" in remark.message
    drawn = [line for line in render_plan(made).splitlines() if line.startswith("  ")]
    assert any(line.startswith("  2 ") and line.count(".") == 2 for line in drawn)
    # The zero of a stage is not exact.
    assert planned(GOOD.replace("pan_deg: 2", "pan_deg: 13")).remarks == ()


def test_angles_that_look_like_radians_are_remarked():
    (remark,) = planned(GOOD.replace("pan_deg: 2", "pan_deg: 0.79")).remarks
    assert "within 0.21 degrees" in remark.message


def test_the_faults_of_both_files_are_reported_at_once(tmp_path):
    sequence, station = tmp_path / "sequence.yaml", tmp_path / "station.yaml"
    sequence.write_text(HEAD + "defaults: {record: {window_ms: -33}}\nsteps: [lihgt]\n")
    station.write_text(PLAIN.replace("driver: scpi", "driver: scpy").replace("serial: 100101", "serial:"))
    with pytest.raises(ScriptError) as caught:
        load_documents(str(sequence), str(station))
    named = [fault.partition(":")[0] for fault in caught.value.faults]
    assert named == [str(sequence)] * 2 + [str(station)] * 2, str(caught.value)
    assert caught.value.exit_status == 2


def test_angles_are_compared_with_the_station_even_in_a_sequence_that_has_other_faults(tmp_path):
    sequence = tmp_path / "s.yaml"
    sequence.write_text(
        HEAD + "poses: {a: [{pan_deg: 99}, {pan_deg: x}, {roll_deg: 1}, {pan_deg: 1e999}]}\nsteps: [mvoe]\n"
    )
    with pytest.raises(ScriptError) as caught:
        load_documents(str(sequence), "simulated")
    assert [fault.split(": ")[1] for fault in caught.value.faults] == [
        "poses.a[1].pan_deg", "poses.a[3].pan_deg", "steps[0].mvoe", "poses.a[0].pan_deg", "poses.a[2].roll_deg",
    ]  # fmt: skip


def test_the_plan_as_json_is_plain_and_names_no_place_of_this_machine():
    made = make_plan(*load_documents("nine_pose", "simulated"))
    text = json.dumps(made.to_dict(), allow_nan=False)
    assert str(Path.cwd()) not in text
    assert str(SHIPPED_STATIONS.parent) not in text
    data = json.loads(text)
    assert (data["runnable"], data["simulated"], len(data["poses"])) == (True, True, 9)
    document = check_document((HEAD + "steps: [solve]\n").encode(), "folder/s.yaml", Sequence)
    fault = make_plan(document, STATION).to_dict()["faults"][0]
    assert (fault["file"], fault["line"], fault["path"]) == ("s.yaml", 3, "steps[0].solve")
    assert data["steps"][-1]["done_after_s"] == pytest.approx(data["duration_s"])


numbers = st.sampled_from(["0", "-6", "6.5", "60", "1e-3", "99999", "100"])


@settings(max_examples=60)
@given(st.sampled_from(SEQUENCES), st.data())
def test_a_sequence_with_other_numbers_is_planned_or_refused_never_anything_else(path, data):
    text = path.read_text(encoding="utf-8")
    written = list(re.finditer(r"(?<=[ \[])-?[0-9][0-9.]*(?=[,}\]])", text))
    for number in reversed(written):
        if data.draw(st.integers(0, 5)) == 0:
            text = text[: number.start()] + data.draw(numbers) + text[number.end() :]
    try:
        made = make_plan(check_document(text.encode(), "s.yaml", Sequence), STATION)
    except DocumentFaults as error:
        event(f"refused by the reader: {len(error.faults)}")
        return
    assert made.duration_s > 0
    assert json.dumps(made.to_dict(), allow_nan=False)
    assert ("cannot be run" in render_plan(made)) == bool(made.faults)


SOLVED = """\
limits: [{result: %s, lower: 1}]
steps:
  - light
  - repeat: {poses: [{pan_deg: -4}, {pan_deg: 4}], steps: [move, settle, record]}
  - solve: {model: %s, distortion: [k1]}
%s"""


@pytest.mark.parametrize(
    ("result", "model", "estimated"),
    [
        ("fx", "planar", True), ("k3", "joint", True), ("r", "planar", False), ("k3", "spherical", False),
        ("kb1", "joint", False),
    ],
)  # fmt: skip
def test_a_limit_of_a_result_that_the_run_does_not_estimate_is_refused(result, model, estimated):
    places = [line.rpartition(": ")[0] for line in faults(SOLVED % (result, model, "  - report\n"))]
    assert places == ([] if estimated else ["s.yaml:3:19: limits[0].result"])


def test_a_limit_of_the_station_counts_too_and_needs_a_result():
    limited = document_of(PLAIN + "limits: [{result: k3, upper: 1}]\n")
    with_report = SOLVED % ("fx", "spherical", "  - report\n")
    assert "the station limits k3: " in faults(with_report, limited)[0]
    assert any("limits need a" in fault for fault in faults(SOLVED % ("fx", "spherical", "")))


@pytest.mark.parametrize(
    ("section", "fault_text"),
    [
        ("{stge: {}}", "simulation.stge: Unknown key"),
        ("{faults: [{device: pan, fault: no}]}", "simulation.faults[0].fault: "),
        ("{rehearsal: {lost_share: -1}}", "simulation.rehearsal.lost_share: -1 is"),
        ("{stage: {pan: {limit_deg: 20}}}", ""),
    ],
)
def test_a_wrong_key_of_the_simulation_is_found_by_the_plan_at_its_place(section, fault_text):
    station = document_of(IDEAL.replace("simulation: {}", f"simulation: {section}"))
    messages = faults(GOOD, station)
    assert len(messages) == bool(fault_text)
    assert all(fault_text in fault and fault.startswith("station.yaml:8:") for fault in messages)


def test_an_axis_that_the_simulated_stage_lacks_is_named_by_the_plan():
    (tilt,) = re.findall(r"\n    tilt:\n(?:      .*\n)+", IDEAL)
    roll = tilt.replace("tilt:", "roll:").replace("100102", "100103").replace("device: 2", "device: 3")
    (fault,) = faults(GOOD, document_of(IDEAL.replace(tilt, tilt + roll.lstrip("\n"))))
    assert "no axis roll" in fault


def test_a_loss_that_the_model_does_not_use_is_said_by_the_plan_and_not_listed_as_used():
    def printed_with(settings):
        made = planned(GOOD.replace("solve,", f"{{solve: {settings}}},"))
        return [remark.message for remark in made.remarks], render_plan(made)

    (remark,), text = printed_with("{loss: cauchy}")
    assert "the loss" in remark
    assert "solve auto, k1 k2 " in text
    remarks, text = printed_with("{model: spherical, loss: cauchy}")
    assert remarks == []
    assert "solve spherical, k1 k2, cauchy" in text
