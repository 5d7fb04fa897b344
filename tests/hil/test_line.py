"""The line in a real browser: scan, one button, and a word to be read from 3 m. Skipped where no Chromium is."""

from __future__ import annotations

import json
import os
import re
from types import SimpleNamespace

import httpx
import pytest
from pages import served
from quick_runs import THREE, TWELVE, write_sequence, write_station
from running import called, journal

from bench.base.errors import UsageError
from bench.extras.panel.line import Line
from bench.extras.panel.panel_app import panel_app
from bench.record.events import Event
from bench.web.token import PageToken
from calib.model.cause import Cause

PATIENCE_MS = 90_000
SERIAL = "00050423"


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def line(folder, upper=1750, poses=THREE, limits="limits: [{result: fx, lower: 1600, upper: %s}]\n"):
    sequence = write_sequence(folder / "s.yaml", poses)
    station = write_station(folder / "b.yaml", more=limits % upper if limits else "")
    return Line(folder / "runs", str(sequence), str(station), "A. Operator")


def picture(tab, name):
    """Keep a picture where somebody wants to look at the pages."""
    if folder := os.environ.get("STARBENCH_PICTURES"):
        tab.screenshot(path=f"{folder}/line-{name}.png")


def own(server):
    """The header of a request by one of our own pages."""
    return {"Origin": server.url.rstrip("/")}


def scan(tab, text):
    """What a scanner does: it types, and presses Enter."""
    tab.keyboard.type(text)
    tab.keyboard.press("Enter")


@pytest.mark.parametrize(("upper", "phase", "word"), [(1750, "pass", "PASS"), (1600.5, "fail", "FAIL")])
def test_a_scanned_camera_is_measured_and_its_verdict_is_the_largest_thing_on_the_page(
    chromium, tmp_path, home, upper, phase, word
):
    with served(
        panel_app(tmp_path / "runs", line(tmp_path, upper)), token=PageToken("token-of-the-line")
    ) as server:
        tab = chromium.new_context(viewport={"width": 1280, "height": 800}).new_page()
        tab.goto(f"{server.url}sign-in#token=token-of-the-line")
        tab.wait_for_url("**/line")
        assert tab.inner_text("#word") == "READY"
        picture(tab, "ready")
        scan(tab, SERIAL)
        tab.wait_for_selector("body[data-phase=running]")
        assert tab.inner_text("#go") == "STOP"
        picture(tab, "running")
        tab.wait_for_selector(f"body[data-phase={phase}]", timeout=PATIENCE_MS)
        picture(tab, phase)
        assert (tab.inner_text("#word"), tab.inner_text("#of")) == (word, f"Camera {SERIAL}")
        assert (
            tab.eval_on_selector("#word", "one => parseFloat(getComputedStyle(one).fontSize)") >= 0.2 * 1280
        )
        assert tab.eval_on_selector("body", "one => one.scrollWidth") <= 1280
        assert tab.is_visible("text=SIMULATED")
        assert "fx 16" in tab.inner_text("#lines")
        assert tab.evaluate("document.activeElement.id") == "serial"  # ready for the next scan
        assert tab.input_value("#serial") == ""
        tab.click("#details")
        tab.wait_for_selector("text=Last recording")
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if path.is_dir())
    assert json.loads((folder / "results.json").read_text())["run"]["operator"] == "A. Operator"


def test_another_camera_than_the_scanned_one_is_refused_before_anything_moves(chromium, tmp_path, home):
    with served(panel_app(tmp_path / "runs", line(tmp_path))) as server:
        tab = chromium.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(server.url)
        tab.wait_for_selector("body[data-phase=ready]")
        scan(tab, "   ")
        tab.wait_for_selector("text=No serial number was scanned.")
        tab.fill("#serial", "")
        scan(tab, "00099999")
        tab.wait_for_selector("body[data-phase=refused]", timeout=PATIENCE_MS)
        picture(tab, "refused")
        assert tab.inner_text("#word") == "WRONG CAMERA"
        assert tab.eval_on_selector("body", "one => one.scrollWidth") <= 1280
        assert f"This is camera {SERIAL}, not 00099999." in tab.inner_text("#lines")
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if path.is_dir())
    entries = journal(folder)
    assert Event.CAPTURE_STORED not in [entry["event"] for entry in entries]
    assert not re.search("homing|slewing|lighting", json.dumps(entries))


def test_the_button_stops_a_run_safely(chromium, tmp_path, home):
    with served(panel_app(tmp_path / "runs", line(tmp_path, poses=TWELVE))) as server:
        tab = chromium.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(server.url)
        tab.wait_for_selector("body[data-phase=ready]")
        scan(tab, SERIAL)
        tab.wait_for_selector("text=poses", timeout=PATIENCE_MS)
        tab.click("#go")
        tab.wait_for_selector("body[data-phase=stopped]", timeout=PATIENCE_MS)
        picture(tab, "stopped")
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if path.is_dir())
    assert "A. Operator" in json.dumps(journal(folder))


def test_a_line_needs_a_token_as_every_page(tmp_path, home):
    with served(panel_app(tmp_path / "runs", line(tmp_path)), token=PageToken("token-of-the-line")) as server:
        for path in ("line", "api/line"):
            assert httpx.get(f"{server.url}{path}").status_code == 401
        begun = httpx.post(f"{server.url}api/line/begin", json={"serial": SERIAL}, headers=own(server))
        assert begun.status_code == 401
        assert not (tmp_path / "runs").exists()


def test_a_panel_without_a_line_has_no_such_page(tmp_path):
    with served(panel_app(tmp_path)) as server:
        begun = httpx.post(f"{server.url}api/line/begin", json={"serial": SERIAL}, headers=own(server))
        assert (begun.status_code, httpx.get(f"{server.url}line").status_code) == (404, 404)


def test_what_a_person_did_takes_the_place_of_a_green_word(tmp_path, home, monkeypatch):
    cause = Cause("computer stood still", 100.0, 60.0, unit="s").to_dict()
    results = {
        "conformity": {"passed": True, "rule": "", "statements": [], "reasons": []},
        "causes": [cause],
    }

    class Ended:
        """A run whose process has ended; it has told its results."""

        def __init__(self, words, stdout, **_):
            stdout.write(json.dumps({"results": results}).encode())

        def poll(self):
            return 0

    made = line(tmp_path)
    monkeypatch.setattr("bench.extras.panel.line.subprocess.Popen", Ended)
    made.begin(SERIAL)
    state = made.state()
    assert (state["phase"], state["word"]) == ("doubt", "CHECK")
    assert state["lines"][0].startswith("This computer stood still for 60 s during the run")


def test_a_run_whose_process_still_lives_after_its_end_is_not_called_failed_beside_measuring(
    tmp_path, home, monkeypatch
):
    class Ending:
        def __init__(self, *_, **__):
            pass

        def poll(self):
            return None

    made = line(tmp_path)
    monkeypatch.setattr("bench.extras.panel.line.subprocess.Popen", Ending)
    monkeypatch.setattr("bench.extras.panel.line.read_status", lambda _: SimpleNamespace(ended="failed"))
    made.begin(SERIAL)
    state = made.state()
    assert (state["word"], state["lines"]) == ("MEASURING", ["ending"])


def test_a_line_without_limits_does_not_begin(tmp_path, home):
    with pytest.raises(UsageError, match="A line needs limits"):
        line(tmp_path, limits="")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--expect-serial", "-"], "No serial number was scanned."),
        (["--expect-serial", "a\tb"], "is no serial number."),
        (
            ["--expect-serial", "5", "--set", "station.camera.serial=6"],
            "--expect-serial cannot be used with --set",
        ),
    ],
)
def test_a_text_that_is_no_serial_number_is_one_clear_error_and_nothing_is_written(
    tmp_path, home, words, message
):
    ended = called("run", "three_pose", "-s", "simulated", "-o", tmp_path / "run", *words, home=home)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert message in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


WORDS = {"ready": "READY", "running": "MEASURING", "pass": "PASS", "doubt": "CHECK", "fail": "FAIL"}
WORDS |= {"refused": "WRONG CAMERA", "stopped": "STOPPED", "broken": "NOT MEASURED"}


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)])
def test_no_word_is_wider_than_its_page(chromium, tmp_path, width, height):
    class Shown:
        phase = "ready"

        def state(self):
            word = WORDS[self.phase]
            return {
                "phase": self.phase,
                "word": word,
                "serial": SERIAL,
                "lines": [],
                "run": "",
                "simulated": True,
            }

    shown = Shown()
    with served(panel_app(tmp_path, shown)) as server:
        tab = chromium.new_page(viewport={"width": width, "height": height})
        for shown.phase in WORDS:
            tab.goto(f"{server.url}line")
            tab.wait_for_selector(f"body[data-phase={shown.phase}]")
            assert tab.eval_on_selector("#word", "one => one.scrollWidth - one.clientWidth") <= 0, shown.phase
