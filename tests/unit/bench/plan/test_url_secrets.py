"""No credential in a URL of a sequence, station or queue: refused before a run, with the form to write instead."""

import pytest
from station_texts import PLAIN

from bench.base.errors import ScriptError, UsageError
from bench.batch.batch_plan import read_job, read_queue
from bench.plan.plan import SHIPPED_SEQUENCES, load_documents, make_plan
from bench.stations.station_cameras import OpenCvCameraConfig
from sequences.reader import find_document

SECRET = "pa55"
HOOK = f"\nmessages: {{webhooks: [{{url: 'https://bot:{SECRET}@chat.example/'}}]}}\n"


def plan_of(tmp_path, more="", sequence="three_pose", **words):
    path = tmp_path / "station.yaml"
    path.write_text(PLAIN + more)
    return make_plan(*load_documents(sequence, str(path), **words))


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (HOOK, "url_env: NAME in place of url"),
        ("\nmessages: {webhooks: [{url: 'https://hooks.slack.com/services/T/B/x'}]}\n", "url_env: NAME"),
        (f"\n# the camera is rtsp://admin:{SECRET}@10.0.0.9/\n", "this line contains a URL with a password"),
        (f"\n# the camera is https://x%3A{SECRET}@10.0.0.9/\n", "this line contains a URL with a password"),
        (
            f"\noperator: Ada, https://lab.example/?token={SECRET}\n",
            "operator: this is a URL with a token",
        ),
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


def test_a_sequence_with_a_credential_is_refused(tmp_path):
    text = find_document("three_pose", SHIPPED_SEQUENCES).read_text()
    (tmp_path / "own.yaml").write_text(f"{text}# from https://u:{SECRET}@git.example/\n")
    (fault,) = plan_of(tmp_path, sequence=str(tmp_path / "own.yaml")).faults
    assert "own.yaml" in str(fault)


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
    found = camera(source_env="CAM")
    assert found.ports == ()
    assert found.source_in_use({"CAM": "rtsp://admin:pw@10.0.0.9/"}) == "rtsp://admin:pw@10.0.0.9/"
    assert camera(source="/dev/video0").source_in_use({}) == "/dev/video0"


@pytest.mark.parametrize(("environ", "why"), [({}, "is not set"), ({"CAM": "concat:a|b"}, "is not a source")])
def test_a_variable_without_a_source_is_an_error_that_does_not_show_it(environ, why):
    with pytest.raises(UsageError, match=why) as refused:
        camera(source_env="CAM").source_in_use(environ)
    assert "concat" not in str(refused.value)


@pytest.mark.parametrize("words", [{}, {"source": "0", "source_env": "CAM"}])
def test_a_camera_has_one_source(words):
    with pytest.raises(ValueError, match="either source or source_env"):
        camera(**words)
