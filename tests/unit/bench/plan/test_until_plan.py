"""Plans: of runs that choose their poses, options of the solve step, and credentials in URLs."""

from pathlib import Path
from typing import get_args

import pytest
from flat import flatten
from station_texts import PLAIN, without

from bench.base.errors import ScriptError, UsageError
from bench.batch.batch_plan import read_job, read_queue
from bench.plan.job import Job, ParkStep, calibration_options
from bench.plan.plan import load_documents, make_plan
from bench.stations.cameras import OpenCvCameraConfig
from calib.calibration import LossName, ModelName
from calib.model.camera import DISTORTION_SETS, SKEW
from calib.model.lens import BROWN, FISHEYE
from sequences import solve_schema as schema
from sequences.reader import check_document
from sequences.schema import Sequence
from sequences.script import ChooseStep, LightStep, MoveStep

SHIPPED = Path(__file__).parents[4] / "sequences" / "until_good.yaml"


@pytest.fixture
def plan():
    return make_plan(*load_documents(str(SHIPPED), "simulated"))


def planned(tmp_path, until, *, station="simulated", more=""):
    path = tmp_path / "s.yaml"
    path.write_text(
        f"format: starbench/sequence/1\nname: t\n{more}steps:\n  - light\n  - until: {until}\n  - solve\n  - report\n"
    )
    return make_plan(*load_documents(str(path), str(station)))


def test_fewer_recordings_or_minutes_make_it_shorter_and_smaller(tmp_path):
    start = "start: [{pan_deg: -6}, {pan_deg: 6}, {tilt_deg: 3}]"
    many = planned(tmp_path, f"{{expanded_fx_px: 1, at_most: 25, {start}}}")
    few = planned(tmp_path, f"{{expanded_fx_px: 1, at_most: 5, {start}}}")
    short = planned(tmp_path, f"{{expanded_fx_px: 1, at_most: 25, minutes: 0.2, {start}}}")
    assert few.duration_s < short.duration_s < many.duration_s
    assert few.size_bytes < short.size_bytes < many.size_bytes
    assert few.most_bytes < many.most_bytes


def test_plan_json_names_the_rounds_and_the_bounds(plan):
    data = plan.to_dict()
    (until,) = data["untils"]
    assert data["most_poses"] == until["at_most"] == 25
    assert (until["starts"], until["minutes"]) == (3, 20)
    assert until["goals"] == {"expanded_fx_px": 2.5, "worst_corner_px": 1.5}
    assert len(data["poses"]) == 3
    assert data["steps"][until["first"] - 1]["what"] == "move"


def test_the_stage_parks_after_the_last_round(plan):
    job = Job.from_plan(plan, seed=1, operator=None)
    place = next(i for i, step in enumerate(job.steps) if isinstance(step, ParkStep))
    assert isinstance(job.steps[place - 1], LightStep)


def test_a_chosen_pose_has_its_angles_from_the_journal_and_others_turn_every_axis(plan):
    job = Job.from_plan(plan, seed=1, operator=None)
    moves = [step for step in job.steps if isinstance(step, MoveStep)]
    chosen = {4: {"pan": 1.5, "tilt": -2.0}}
    assert job.at_its_pose(moves[3], chosen).pose.angles_deg == {"pan": 1.5, "tilt": -2.0}
    assert job.at_its_pose(moves[2], chosen).pose.angles_deg == {"pan": 0.0, "tilt": -3.0}
    with pytest.raises(KeyError):
        job.at_its_pose(moves[4], chosen)


def test_it_cannot_begin_from_nothing_without_expectations(tmp_path):
    station = tmp_path / "b.yaml"
    station.write_text(without(PLAIN, "expected"))
    assert not planned(tmp_path, "{expanded_fx_px: 1}").faults
    (message,) = {fault.message for fault in planned(tmp_path, "{expanded_fx_px: 1}", station=station).faults}
    assert "at least 2 poses" in message


def test_a_start_outside_the_limits_and_recordings_in_the_dark_are_refused(tmp_path):
    faults = planned(tmp_path, "{expanded_fx_px: 1, start: [{pan_deg: 40}, {pan_deg: 1}]}").faults
    assert any("pan 40 deg" in fault.message for fault in faults)
    path = tmp_path / "dark.yaml"
    path.write_text(
        "format: starbench/sequence/1\nname: t\n"
        "steps: [{until: {expanded_fx_px: 1, start: [{pan_deg: 1}, {pan_deg: 2}]}}, solve, report]\n"
    )
    (fault,) = make_plan(*load_documents(str(path), "simulated")).faults
    assert "in the dark" in fault.message


def test_a_choice_uses_the_same_passport_as_the_solve():
    certificate = {
        "station.collimator.certificate.r_mm": "255",
        "station.collimator.certificate.uncertainty_mm": "0.1",
        "station.collimator.certificate.k": "2",
        "station.collimator.certificate.number": "C-1",
    }
    plan = make_plan(*load_documents(str(SHIPPED), "simulated", certificate))
    assert not plan.faults
    steps = [step for step in plan.script if isinstance(step, ChooseStep)]
    assert plan.passport.in_use is not None
    assert all(plan.passport_for(step.solve) is plan.passport.in_use.passport for step in steps)


# ---------------------------------------------------------------- words of a solve step

TEXT = "format: starbench/sequence/1\nname: S\nsteps: [{move: {pan_deg: 1}}, record, {solve: %s}]\n"


def solve_step(settings: str):
    return flatten(check_document((TEXT % settings).encode(), "s.yaml", Sequence))[-1]


def test_the_script_language_has_every_model_lens_and_loss_of_the_engine():
    assert set(get_args(schema.CalibrationModel)) == set(get_args(ModelName))
    assert set(get_args(schema.Loss)) == set(get_args(LossName))
    assert ((*BROWN, SKEW), FISHEYE) == schema.LENS_FAMILIES
    assert get_args(schema.DistortionTerm) == (*BROWN, SKEW, *FISHEYE)
    assert dict(schema.DISTORTION_SETS) == dict(DISTORTION_SETS)
    assert set(get_args(schema.DistortionSet)) == {*DISTORTION_SETS, "auto"}
    limits = set(schema.LimitConfig.model_fields)
    assert {f"sigma_{name}" for name in (*BROWN, "skew_px", *FISHEYE)} <= limits


@pytest.mark.parametrize("name", DISTORTION_SETS)
def test_every_set_of_lens_coefficients_reaches_the_engine(name):
    assert calibration_options(solve_step(f"{{distortion: {name}}}")).distortion == DISTORTION_SETS[name]


def test_the_other_settings_reach_the_engine():
    made = calibration_options(
        solve_step("{loss: l2, huber_px: 0.5, guard_band: 0.9, drift_mm: 0.2, distortion: [kb2, kb1]}")
    )
    assert (made.loss, made.huber_px, made.guard_band) == ("l2", 0.5, 0.9)
    assert made.distortion == ("kb1", "kb2")


# ---------------------------------------------------------------- no credential in a URL

SECRET = "pa55"

HOOK = f"\nmessages: {{webhooks: [{{url: 'https://bot:{SECRET}@chat.example/'}}]}}\n"


def plan_of(tmp_path, more="", sequence="three_pose", **words):
    path = tmp_path / "station.yaml"
    path.write_text(PLAIN + more)
    return make_plan(*load_documents(sequence, str(path), **words))


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("\n# tells https://hooks.slack.com/services/T/B/x\n", "a secret address of Slack"),
        (f"\n# the camera is rtsp://admin:{SECRET}@10.0.0.9/\n", "this line contains a URL with a password"),
        (f"\n# the camera is https://x%3A{SECRET}@10.0.0.9/\n", "this line contains a URL with a password"),
        (f"\noperator: Ada, https://lab.example/?token={SECRET}\n", "operator: this is a URL with a token"),
    ],
)
def test_a_station_with_a_credential_is_refused_at_its_line(tmp_path, more, says):
    (fault,) = plan_of(tmp_path, more).faults
    assert says in str(fault)
    assert fault.line > PLAIN.count("\n")
    assert SECRET not in str(fault)


def test_a_setting_with_a_credential_is_refused(tmp_path):
    settings = {"station.laboratory": f"https://x:{SECRET}@lab.example/"}
    assert "URL with a password" in str(plan_of(tmp_path, settings=settings).faults[0])


def test_webhooks_are_refused_at_their_line_with_what_to_write_now(tmp_path):
    for hook, faults in (("http://127.0.0.1:1/", 1), (f"https://bot:{SECRET}@chat.example/", 2)):
        found = plan_of(tmp_path, f"\nmessages: {{webhooks: [{{url: '{hook}'}}]}}\n").faults
        assert len(found) == faults  # of a secret address, the second one says so
        assert SECRET not in "".join(map(str, found))
        (fault,) = [fault for fault in found if fault.path == "messages.webhooks"]
        assert "apprise: [{url_env: NAME}]" in fault.message
        assert fault.line > PLAIN.count("\n")


def test_the_files_of_a_run_that_has_begun_are_read_as_they_are(tmp_path):
    path = tmp_path / "station.yaml"
    path.write_text(PLAIN + HOOK)
    assert make_plan(*load_documents("three_pose", str(path)), passport_copy=tmp_path / "none").faults == ()


@pytest.mark.parametrize("read", [read_queue, read_job])
def test_a_queue_or_job_with_a_credential_is_refused(tmp_path, read):
    job = f"{{name: a, sequence: three_pose, station: simulated, settings: {{station.operator: 'https://u:{SECRET}@h/'}}}}"
    text = f"format: starbench/queue/1\nname: q\njobs: [{job}]\n"
    if read is read_job:
        text = f"format: starbench/job/1\nname: a\nsequence: three_pose\nstation: simulated\n# https://u:{SECRET}@h/\n"
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(ScriptError, match="URL with a password") as refused:
        read(tmp_path / "file.yaml")
    assert SECRET not in str(refused.value)


def camera(**words):
    return OpenCvCameraConfig(driver="opencv", **words)


def test_the_source_of_a_camera_may_be_an_environment_variable():
    config = camera(source_env="CAM")
    assert config.ports == ()
    assert config.source_in_use({"CAM": "rtsp://admin:pw@10.0.0.9/"}) == "rtsp://admin:pw@10.0.0.9/"
    assert camera(source="/dev/video0").source_in_use({}) == "/dev/video0"


@pytest.mark.parametrize(("environ", "why"), [({}, "is not set"), ({"CAM": "concat:a|b"}, "is not a source")])
def test_a_variable_without_a_source_is_an_error_that_does_not_show_it(environ, why):
    with pytest.raises(UsageError, match=why) as refused:
        camera(source_env="CAM").source_in_use(environ)
    assert "concat" not in str(refused.value)


@pytest.mark.parametrize("words", [{}, {"source": "0", "source_env": "CAM"}])
def test_a_camera_has_one_source(words):
    with pytest.raises(ValueError, match="source or source_env"):
        camera(**words)
