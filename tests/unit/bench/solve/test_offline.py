"""Calibrating from files alone: point files, what is refused, and the folder that it makes."""

import hashlib
import json
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from station_texts import IDEAL, PLAIN, without

from bench.again.recalculated import check_recalculated
from bench.base.errors import BenchError, UsageError
from bench.commands.cli import cli
from bench.commands.keys import key_or_draft
from bench.evidence.keys import create_key
from bench.evidence.verify import verify_folder
from bench.solve import loose_recordings
from bench.solve.loose_recordings import used_part, used_recordings
from bench.solve.offline import calibrate_paths, odd_sizes, require_one_camera, views_of_one_size
from bench.solve.offline_folder import write_offline_results
from bench.solve.offline_options import OfflineOptions
from bench.solve.passports import sealed_bytes
from bench.solve.solve_options import ONE_VIEW
from bench.solve.view_sources import ViewSource, picture_of, refuse_truncated_jpeg, view_sources
from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews, InputMismatch
from calib.model.passport import Passport
from calib.view import View
from drivers.errors import RecordingCorrupt
from tests.support.printed_text import printed_text


def view(name, size):
    flat = np.zeros((1, 2))
    return View(name, size, np.zeros(1, np.int64), flat, flat, np.eye(2)[None])


@pytest.mark.parametrize(
    ("names", "pictures"), [(("lying", "on end"), [True, True]), (("lying", "points"), [True, False])]
)
def test_views_of_different_image_sizes_are_refused(names, pictures):
    views = [view(name, size) for name, size in zip(names, [(1280, 720), (720, 1280)], strict=True)]
    with pytest.raises(BenchError, match="different image sizes"):
        views_of_one_size(views, pictures)


def sized(name, *, is_sized=True):
    return ViewSource(Path(f"{name}.png"), lambda: None, sized=is_sized)


@pytest.mark.parametrize(("large", "left_out"), [(8, ["small", "on end"]), (7, [])])
def test_a_few_images_of_another_size_are_left_out_with_a_word(large, left_out):
    views = [
        view("small", (640, 360)),
        *(view(f"{n}", (1280, 720)) for n in range(large)),
        view("on end", (720, 1280)),
    ]
    odd = odd_sizes(views, [sized(view.name) for view in views])
    assert [views[at].name for at, _ in odd] == left_out
    for (at, sentence), name in zip(odd, left_out, strict=True):
        width, height = views[at].image_size
        assert re.search(f"^{name}.png: .*{width} x {height} px, 8 .* 1280 x 720", sentence)


def test_point_files_take_the_size_of_the_pictures_beside_them_and_else_the_largest():
    views = [view("picture", (1280, 720)), view("points", (900, 600))]
    assert [view.image_size for view in views_of_one_size(views, [True, False])] == [(1280, 720)] * 2
    views = [view("a", (1200, 600)), view("b", (900, 700))]
    assert [view.image_size for view in views_of_one_size(views, [False, False])] == [(1200, 700)] * 2


@pytest.mark.parametrize("word", ["0x720", "1280"])
def test_an_image_without_pixels_is_no_size(word):
    with pytest.raises(UsageError, match="not an image size"):
        OfflineOptions.from_command_line(image_size=word)
    assert OfflineOptions.from_command_line(image_size="1280x720").image_size == (1280, 720)
    assert OfflineOptions().image_size is None


def test_a_jpeg_that_is_cut_off_is_no_picture(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (120, 160), np.uint8)
    whole = cv2.imencode(".jpg", noise)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(whole)
    refuse_truncated_jpeg(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(whole + b"what cameras put behind it")
    refuse_truncated_jpeg(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(whole[: int(0.999 * len(whole))])
    with pytest.raises(RecordingCorrupt, match="incomplete"):
        refuse_truncated_jpeg(tmp_path / "a.jpg")


def test_a_recording_that_ends_within_a_word_is_named_once_and_belongs_to_no_run(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(b"% format EVT2;height=720;width=1280\n% end\n" + bytes(16))
    assert used_recordings([path]) == []
    path.write_bytes(path.read_bytes()[:-1])
    (sentence,) = used_recordings([path, path])
    assert f": {path}." in sentence


HEAD = b"% format EVT3;height=720;width=1280\n% end\n"


def write_long(path):
    """A recording of 200 000 words, an event each."""
    path.write_bytes(HEAD + np.full(200_000, 0x2000, "<u2").tobytes())
    return path


def test_of_a_long_recording_the_first_events_are_used_and_that_is_told(tmp_path, monkeypatch):
    path = write_long(tmp_path / "a.raw")
    with used_part(path) as whole:
        assert whole == path
    assert used_recordings([path]) == []
    monkeypatch.setattr(loose_recordings, "MOST_EVENTS", 100_000)
    with used_part(path) as begin:
        size = begin.stat().st_size
        assert begin.read_bytes() == path.read_bytes()[:size]
    assert 0 < (size - len(HEAD)) // 2 <= 100_000
    (sentence,) = used_recordings([path])
    assert sentence.endswith(f"{path} ({size / path.stat().st_size:.0%}).")
    assert used_recordings([path], in_pieces={path}) == []


def write_dark(path):
    """A recording of which no event shows a target: EVT2, the time alone."""
    words = np.full(2000, 0x80000000, "<u4")
    path.write_bytes(b"% format EVT2;height=720;width=1280\n% end\n" + words.tobytes())


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("a.csv", Path.mkdir),
        ("a.csv", lambda path: path.symlink_to("nowhere")),
        ("a.csv", os.mkfifo),
        ("dark.raw", write_dark),
    ],
    ids=["folder", "lost link", "pipe", "dark"],
)
def test_too_few_views_are_told_with_what_was_left_out_by_its_own_name(tmp_path, name, make):
    make(tmp_path / name)
    (tmp_path / "points.txt").write_text("".join(f"{x} {y} {x} {y} {n}\n" for n, (x, y) in enumerate(GRID)))
    with pytest.raises(DegenerateViews, match=r"1 view .* 1 file ") as refused:
        calibrate_paths([tmp_path], OfflineOptions(image_size=(64, 48)))
    assert str(refused.value).count(name) == 1


def test_recordings_of_different_cameras_are_refused_by_their_serial_numbers(tmp_path):
    serials = {"a": "00051", "b": "51", "c": "", "d": "00052"}
    for name, serial in serials.items():
        line = f"% serial_number {serial}\n" if serial else ""
        (tmp_path / f"{name}.raw").write_bytes(f"% format EVT3;height=720;width=1280\n{line}% end\n".encode())
    sources = [ViewSource(tmp_path / f"{name}.raw", lambda: None) for name in serials]
    require_one_camera(sources[:3])
    with pytest.raises(BenchError, match=r"2 cameras, .*: 00051 \(a, b\), 00052 \(d\)"):
        require_one_camera(sources)


def test_text_with_a_line_for_each_event_is_a_recording_and_is_found_again_with_another_size(tmp_path):
    path, points = tmp_path / "a.csv", tmp_path / "b.csv"
    path.write_text("757,201,0,1\n566,568,1,7\n")
    points.write_text("757,201,4,8,1\n")
    (at_first,) = view_sources(path, OfflineOptions(image_size=(1280, 720)))
    (then,) = view_sources(path, OfflineOptions(image_size=(1300, 800)))
    assert at_first.decided_by["kind"] == "other .csv"
    assert at_first.decided_by != then.decided_by
    assert next(view_sources(points, OfflineOptions())).decided_by is None


GRID = [(x, y) for x in range(5, 60, 10) for y in range(5, 45, 10)]


# ---------------------------------------------------------------- the folder


@pytest.fixture(scope="module")
def passport(tmp_path_factory):
    """A passport file of a certificate."""
    path = tmp_path_factory.mktemp("passport") / "p.json"
    path.write_bytes(sealed_bytes(Passport.of_radius(255.0, 0.05, {"certificate": "T-1"}, "")))
    return str(path)


def options(**given):
    return OfflineOptions.from_command_line(image_size="1280x720", **given)


@pytest.fixture(scope="module")
def certified(points, passport):
    """The calibration of the points with the passport."""
    return calibrate_paths([points], options(passport=passport))


@pytest.fixture(scope="module")
def uncertified(points):
    """The calibration of the points alone."""
    return calibrate_paths([points], options(model="spherical"))


def test_the_folder_holds_results_report_exports_and_the_hashes_of_the_inputs(
    points, passport, certified, tmp_path
):
    out = tmp_path / "out"
    write_offline_results(certified, "out", out)
    results = json.loads((out / "results.json").read_text())
    assert results["schema"] == "starbench/results/1"
    assert (results["run"]["offline"], results["run"]["simulated"]) == (True, False)
    assert results["calibration"]["camera"] == certified.calibration.to_dict()["camera"]
    sources = json.loads((out / "sources.json").read_text())["sources"]
    assert sources == results["sources"]
    for source in sources:
        data = (points / f"{source['view']}.csv").read_bytes()
        assert (source["size_bytes"], source["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())
    assert (out / "passport.json").read_bytes() == Path(passport).read_bytes()
    assert results["passport"]["source"] == "command line"
    assert len(list((out / "exports").iterdir())) >= 5
    text = " ".join(printed_text((out / "report.html").read_text()))
    assert all(fact in text for fact in ("OFFLINE: ", "DRAFT: ", sources[0]["sha256"], "number T-1"))
    assert not (out / "SHA256SUMS").exists()


def test_the_folder_is_sealed_and_says_that_it_is_a_recalculation(uncertified, tmp_path, key, signers):
    out = tmp_path / "out"
    write_offline_results(uncertified, "out", out, key)
    run = json.loads((out / "results.json").read_text())["run"]
    assert run["sealed_by"] == {"principal": key.principal, "fingerprint": key.fingerprint}
    assert "a recalculation" in run["statement"]
    assert run["of_runs"] == []
    text = " ".join(printed_text((out / "report.html").read_text()))
    assert f"{key.principal} sealed it" in text
    assert "DRAFT" not in text
    assert "a recalculation" in (out / "VERIFY.txt").read_text()
    assert verify_folder(out, signers).state == "SEALED"
    assert all(path.is_dir() or not path.stat().st_mode & 0o222 for path in out.rglob("*"))


@pytest.mark.parametrize("trouble", [None, "no key", "readable"])
def test_without_a_usable_key_the_folder_stays_a_draft(tmp_path, monkeypatch, capsys, trouble):
    home = tmp_path / "home"
    monkeypatch.setenv("STARBENCH_HOME", str(home))
    if trouble != "no key":
        create_key(home)
    if trouble == "readable":
        (home / "bench_key").chmod(0o644)
    key = key_or_draft()
    assert (key is None) is (trouble is not None)
    assert ("DRAFT: " in capsys.readouterr().err) is (trouble is not None)
    assert (home / "bench_key").exists() is (trouble != "no key")


def test_the_station_file_of_the_target_is_stated_with_its_hash(points, tmp_path, key):
    station, sources = tmp_path / "station.yaml", tmp_path / "out" / "sources.json"
    station.write_text(PLAIN)
    result = calibrate_paths([points], options(station=str(station), model="planar"))
    write_offline_results(result, "out", tmp_path / "out", key)
    described = json.loads(sources.read_text())
    hashed = hashlib.sha256(PLAIN.encode()).hexdigest()
    stated = {"name": str(station), "path": str(station), "sha256": hashed, "text": PLAIN}
    assert described["station"] == {**stated, "passport_source": None}
    station.unlink()
    assert not check_recalculated(tmp_path / "out").faults
    described["option_target"]["pitch_mm"] += 1
    sources.chmod(0o644)
    sources.write_text(json.dumps(described))
    assert any(fault.where == "sources.json" for fault in check_recalculated(tmp_path / "out").faults)


STATED = (
    without(IDEAL, "collimator")
    + """
collimator:
  nominal_r_mm: 255
  certificate: {r_mm: 255.0, uncertainty_mm: 0.1, k: 2, number: T-1, length: seen}
  defocus: {value: 0.001, sigma: 0.0005}
  pupil_to_focus_mm: {value: -20, sigma: 5}
"""
)


@pytest.mark.slow
def test_loose_files_take_what_the_station_states_and_say_that_the_stage_s_readings_are_left_out(
    points, tmp_path, monkeypatch
):
    station = tmp_path / "station.yaml"
    station.write_text(STATED)
    # The adjustment has tests of its own; here a quick one stands for it.
    monkeypatch.setattr(
        "bench.solve.solution.calibrate",
        lambda views, _options: calibrate(views, CalibrationOptions("planar")),
    )
    result = calibrate_paths([points], options(station=str(station)))
    used = result.options
    assert used.passport.values_by_name["r"] == 255.0
    assert (used.focus.defocus, used.focus.pupil_to_focus_mm) == ((0.001, 0.0005), (-20, 5))
    assert {term.kind for term in used.budget} >= {"print_scale", "print_bow"}
    assert used.radial_sigma is not None
    assert result.passport.source == "station certificate"
    assert used.gimbal is None
    assert str(station) in result.skipped[0]
    assert "gimbal" in result.skipped[0]


@pytest.mark.parametrize("other", [{"passport": "none"}, {"model": "planar"}])
def test_a_station_s_certificate_is_not_used_where_no_passport_is(other, tmp_path):
    station = tmp_path / "station.yaml"
    station.write_text(STATED)
    assert options(station=str(station), **other).passport is None


def test_a_folder_with_anything_in_it_is_refused_before_anything_is_calibrated(points, tmp_path):
    (tmp_path / "note.txt").touch()
    ended = CliRunner().invoke(cli, ["calibrate", str(points), "-o", str(tmp_path)])
    assert ended.exit_code != 0
    assert "note.txt" in f"{ended.output} {ended.exception}"
    assert not (tmp_path / "results.json").exists()


def test_a_passport_is_used_and_none_switches_it_off(points, passport, certified):
    assert certified.calibration.model == "joint"
    assert certified.passport is not None
    assert calibrate_paths([points], options(passport="none", model="spherical")).passport is None
    for model in ("spherical", "planar"):
        with pytest.raises(InputMismatch, match="method of reference"):
            calibrate_paths([points], options(passport=passport, model=model))


def test_one_view_without_a_passport_of_the_centre_says_what_one_would_give(
    points, passport, uncertified, tmp_path
):
    for given in (None, passport):
        with pytest.raises(DegenerateViews) as caught:
            calibrate_paths([points / "left.csv"], options(passport=given))
        assert ONE_VIEW in str(caught.value)
    (tmp_path / "whole.json").write_bytes(sealed_bytes(uncertified.calibration.passport()))
    single = calibrate_paths([points / "left.csv"], options(passport=str(tmp_path / "whole.json")))
    assert single.calibration.sigma["fx"] < 0.02 * single.calibration.camera.fx


def test_a_board_gives_tangential_terms_unless_other_coefficients_are_asked_for():
    board = "checkerboard:11x7:20mm"
    estimated = [
        OfflineOptions.from_command_line(board=board, distortion=word).without_run().distortion
        for word in (None, "k1k2")
    ]
    assert estimated == [("k1", "k2", "p1", "p2"), ("k1", "k2")]


def test_the_preview_of_a_long_recording_uses_its_first_events_too(tmp_path, monkeypatch):
    path, read = write_long(tmp_path / "a.raw"), []
    monkeypatch.setattr(loose_recordings, "MOST_EVENTS", 100_000)
    monkeypatch.setattr(
        "bench.measure.measure.recorded_image", lambda begin: read.append(begin.stat().st_size)
    )
    picture_of(path)
    assert read[0] < path.stat().st_size
