"""Many runs calibrated again: as one by one, none lost, none doubled, whatever is interrupted, broken or gone."""

import hashlib
import json
import shutil

import pytest
from click.testing import CliRunner
from expected_stars import THREE, expected_views, write_points

from bench.base.program import forms
from bench.commands.cli import cli
from bench.evidence.keys import create_key
from bench.evidence.signers import SIGNERS_FILE, read_signers
from bench.evidence.verify import verify_folder
from bench.solve.offline import calibrate_paths
from bench.solve.offline_options import OfflineOptions
from bench.work.places import Place, find_places
from bench.work.recalculation import Recalculation
from bench.work.results_folders import TABLE, ResultsFolders
from bench.work.tasks import Task, list_recordings
from bench.work.workers import Serial, WorkersLost

CHOICES = OfflineOptions(model="spherical", distortion="k1", image_size=(1280, 720))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three folders of point files with different noise."""
    root = tmp_path_factory.mktemp("recordings")
    for number in (1, 2, 10):
        write_points(root / f"cam{number}", expected_views(THREE, sigma_px=0.05, seed=number), every=3)
    return root


@pytest.fixture
def folders(made, tmp_path):
    copy = tmp_path / "in"
    shutil.copytree(made, copy)
    return [copy / name for name in ("cam1", "cam2", "cam10")]


@pytest.fixture(autouse=True)
def quick_report(monkeypatch):
    """Reports take seconds, and are not what is tested here."""
    monkeypatch.setattr("bench.solve.result.render_report", lambda _data: "<!DOCTYPE html>")


def task(**given):
    return Task(CHOICES, forms()["program"], kept="", **given)


def recalculate(folders, output=None, workers=None, **calls):
    return Recalculation(
        find_places([str(folder) for folder in folders]), task(), workers or Serial(), output, **calls
    ).run()


def expected(folder):
    solved = calibrate_paths([folder], CHOICES).calibration
    return dict(solved.values), dict(solved.sigma)


def table(folder):
    return [json.loads(line) for line in (folder / TABLE).read_text().splitlines()]


def test_each_run_is_as_it_is_alone_and_its_folder_is_sealed(folders, tmp_path):
    key = create_key(tmp_path / "keys")
    with ResultsFolders(tmp_path / "out", key) as output:
        rows = recalculate(folders, output)
    assert rows == table(tmp_path / "out")
    for folder, row in zip(folders, rows, strict=True):
        assert (row["folder"], row["state"], row["converged"]) == (str(folder), "done", True)
        assert (row["values"], row["sigma"]) == expected(folder)
        results = tmp_path / "out" / row["results"] / "results.json"
        assert hashlib.sha256(results.read_bytes()).hexdigest() == row["results_sha256"]
        stated = json.loads(results.read_bytes())
        assert stated["run"]["id"] == row["results"]
        assert stated["run"]["sealed_by"]["fingerprint"] == key.fingerprint
        signers = read_signers(tmp_path / "keys" / SIGNERS_FILE)
        assert verify_folder(results.parent, signers).state == "SEALED"


@pytest.mark.parametrize("wrong", ["device", "holes"])
def test_a_recording_that_never_ends_or_was_never_written_fails_its_folder_alone(
    folders, tmp_path, wrong, monkeypatch
):
    bad = tmp_path / "bad"
    shutil.copytree(folders[0], bad)
    (bad / "left.csv").unlink()
    if wrong == "device":
        (bad / "left.csv").symlink_to("/dev/zero")
    else:
        with (bad / "left.csv").open("wb") as file:
            file.truncate(10 << 30)

    def hash_of(path):
        assert path.name != "left.csv", "it was read"
        return "0"

    monkeypatch.setattr("bench.work.tasks.sha256_of", hash_of)
    (row,) = recalculate([bad])
    assert row["state"] == "failed"
    what = {"device": "a device, not a file", "holes": "The file is incomplete"}[wrong]
    assert what in row["failure"]["what"]


def test_what_was_done_is_not_done_again_and_what_differs_is(folders, tmp_path):
    with ResultsFolders(tmp_path / "out", None) as output:
        first = recalculate(folders, output)
    shutil.rmtree(tmp_path / "out" / first[0]["results"])
    changed = tmp_path / "out" / first[1]["results"] / "results.json"
    changed.chmod(0o644)
    changed.write_bytes(changed.read_bytes() + b" ")
    points = folders[2] / "left.csv"
    points.write_text("\n".join(points.read_text().splitlines()[:-1]) + "\n")
    ended = []
    with ResultsFolders(tmp_path / "out", None) as output:
        second = recalculate([*folders, folders[0]], output, ended=ended.append)
    assert len(second) == 3, "a folder given twice is calibrated once"
    assert not any(row.get("skipped") for row in ended)
    assert second[0]["values"] == first[0]["values"]
    assert second[1]["results"] == f"{first[1]['results']}-2"
    assert second[2]["key"] != first[2]["key"]
    with ResultsFolders(tmp_path / "out", None) as output:
        third = recalculate(folders, output, ended=ended.append)
    assert third == second == table(tmp_path / "out")
    assert all(row["skipped"] for row in ended[3:])


def test_an_interrupted_recalculation_goes_on_where_it_was(folders, tmp_path):
    def interrupt(_row):
        raise KeyboardInterrupt

    with ResultsFolders(tmp_path / "out", None) as output, pytest.raises(KeyboardInterrupt):
        recalculate(folders, output, ended=interrupt)
    assert [row["state"] for row in table(tmp_path / "out")] == ["done"]
    with (tmp_path / "out" / TABLE).open("a") as stream:  # as after a power cut
        stream.write('{"folder": "torn')
    part = tmp_path / "out" / ".cam2-00000000.tmp"
    part.mkdir()
    (part / "results.json").write_text("{}")
    part.chmod(0o555)
    ended = []
    with ResultsFolders(tmp_path / "out", None) as output:
        rows = recalculate(folders, output, ended=ended.append)
    assert [bool(row.get("skipped")) for row in ended] == [True, False, False]
    assert rows == table(tmp_path / "out")
    assert not part.exists()
    assert len(list((tmp_path / "out").iterdir())) == 4


def test_a_run_that_fails_or_vanishes_stops_no_other(folders, tmp_path):
    for file in folders[0].glob("*.csv"):
        file.write_text("no points\n")
    gone = find_places([str(folder) for folder in folders])
    shutil.rmtree(folders[1])
    with ResultsFolders(tmp_path / "out", None) as output:
        rows = Recalculation(gone, task(), Serial(), output).run()
    assert [row["state"] for row in rows] == ["failed", "failed", "done"]
    assert str(folders[0]) in rows[0]["failure"]["remedy"]
    assert "no such file" in rows[1]["failure"]["what"].lower()
    assert rows == table(tmp_path / "out")


def test_lost_workers_end_the_work_and_keep_what_was_done(folders, tmp_path):
    class Dying(Serial):
        def finished(self, timeout_s):
            if (tmp_path / "out" / TABLE).read_text():
                raise WorkersLost("The scheduler does not answer any more.")
            return super().finished(timeout_s)

    with ResultsFolders(tmp_path / "out", None) as output, pytest.raises(WorkersLost):
        recalculate(folders, output, workers=Dying())
    assert [row["state"] for row in table(tmp_path / "out")] == ["done"]


def test_workers_with_another_program_refuse(folders):
    other = Task(CHOICES, "0" * 16, kept="")
    rows = Recalculation([Place(str(folders[0]))], other, Serial()).run()
    assert rows[0]["state"] == "failed"
    assert "another Starbench" in rows[0]["failure"]["what"]


def test_the_key_covers_recordings_options_and_program(folders):
    place = Place(str(folders[0]))
    keys = {
        list_recordings(place, recalculated).key
        for recalculated in (
            task(),
            Task(OfflineOptions(model="joint", distortion="k1", image_size=(1280, 720)), task().program, ""),
            Task(CHOICES, "0" * 16, ""),
        )
    }
    (folders[0] / "left.csv").write_text("other")
    keys.add(list_recordings(place, task()).key)
    assert len(keys) == 4


def test_a_second_command_in_the_same_folder_is_refused(folders, tmp_path):
    with ResultsFolders(tmp_path / "out", None), pytest.raises(Exception, match="Another process"):
        ResultsFolders(tmp_path / "out", None)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "photo.png").write_text("")
    with pytest.raises(Exception, match="not that of a recalculation"):
        ResultsFolders(tmp_path / "foreign", None)


def test_the_command_gives_the_same_to_the_last_digit_by_the_workers_that_are_here(folders):
    options = ["--image-size", "1280x720", "--model", "spherical", "--distortion", "k1", "--json"]
    shutil.rmtree(folders[1])
    folders[1].mkdir()
    ended = CliRunner().invoke(
        cli, ["calibrate", *map(str, folders), "--each", *options], standalone_mode=False
    )
    assert ended.return_value == 1
    assert "cam1: fx" in ended.stderr
    assert "cam2: FAILED." in ended.stderr
    stated = json.loads(ended.stdout)
    assert (stated["done"], stated["failed"]) == (2, 1)
    for number in (0, 2):
        row = stated["runs"][number]
        assert (row["values"], row["sigma"]) == expected(folders[number])
