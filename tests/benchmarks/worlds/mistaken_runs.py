"""What people do to a bench, through the whole program: a run on a simulated station after a healthy one of that bench.

The sensor is small, the recordings are short, and the poses are five, so that a run takes seconds.
"""

import json
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self
from unittest import mock

import yaml

from bench.record.run_folder import RESULTS
from bench.simulated import SimulatedBench
from bench.stations.station import SHIPPED_STATIONS
from bench.wording import causes as kinds
from calib.model import cause as of_views
from tests.support.running import called, journal, start

Station = dict[str, Any]

SMALL: Final = {"width": 640, "height": 360, "fx": 1672, "fy": 1672, "cx": 320, "cy": 180}
SEQUENCE: Final = """\
format: starbench/sequence/1
name: Five poses
defaults:
  light: {waveform: square, frequency_hz: %(hz)s, duty_percent: %(duty)s}
  settle: {duration_s: 0.3}
  record: {window_ms: 16.8, attempts: 2, backoff_s: 0.1}
steps:
  - light
  - repeat:
      poses:
        - {name: one, pan_deg: -6, tilt_deg: 2}
        - {name: two, pan_deg: 6, tilt_deg: 2}
        - {name: three, pan_deg: 0, tilt_deg: -3}
        - {name: four, pan_deg: -5, tilt_deg: -2}
        - {name: five, pan_deg: 5, tilt_deg: -1}
      steps: [move, settle, record]
  - light: off
  - solve: {model: auto, distortion: [k1]}
  - report
"""
#: The computer sleeps so long, s.
ASLEEP_S: Final = 14.0
#: The earlier run of each bench has a seed that is larger by this; these runs are kept.
EARLIER: Final = 500
EARLIER_RUNS: Final = Path(tempfile.gettempdir()) / f"starbench-earlier-runs-{os.getuid()}"


@dataclass(frozen=True)
class RunMistake:
    """Something that a person does before a run or, by an order, on the way to a pose; what must be told first."""

    change: Callable[[Station], None] = lambda _: None
    named: tuple[str, ...] = ()  # Kinds of causes; with none and no words, nothing may be told
    refused: str = ""  # Pattern of what is told if the run refuses its recordings
    light: Mapping[str, float] | None = None  # Settings of the light in the sequence
    order: Mapping[str, Any] | None = None  # Of the catalogue of faults, on the way to the third pose
    asleep: str = ""  # State of the run in which the computer goes to sleep


def _simulation(section: str, **values: Any) -> Callable[[Station], None]:
    def change(station: Station) -> None:
        station["simulation"].setdefault(section, {}).update(values)

    return change


def _lamp(fault: str, **more: Any) -> Callable[[Station], None]:
    def change(station: Station) -> None:
        station["simulation"]["faults"] = [{"device": "light", "fault": fault, **more}]

    return change


def _section(name: str, **values: Any) -> Callable[[Station], None]:
    return lambda station: station.setdefault(name, {}).update(values)


RUN_MISTAKES: Mapping[str, RunMistake] = {
    "aperture f/11 instead of f/2.8": RunMistake(_simulation("lens", f_number=11.0), kinds.WEAK, "aperture"),
    "aperture f/16": RunMistake(_simulation("lens", f_number=16.0), kinds.WEAK, "open the aperture"),
    "station expects another lens": RunMistake(_section("expected", focal_px=5100), (kinds.LENS,)),
    "another lens on the camera": RunMistake(_simulation("camera", fx=2500, fy=2500), (kinds.LENS,)),
    "target with another tag": RunMistake(_simulation("target", tag_id=7), (), "[Tt]ag 7|[Tt]ag 3"),
    "out of focus": RunMistake(_simulation("lens", focus_distance_m=0.8), (), "out of focus"),
    "lamp not lit, or lens cap": RunMistake(_lamp("lamp_open"), (), "dark.*lens cap"),
    "light of the lamp falls on the lens": RunMistake(
        _simulation("optics", stray=0.2), (), "reaches the lens past the target"
    ),
    "light of the room on the lens": RunMistake(_simulation("optics", room=0.3), (kinds.ROOM,)),
    "bright light of the room on the lens": RunMistake(
        _simulation("optics", room=10.0), (), "darken the room"
    ),
    "trigger cable unplugged": RunMistake(_lamp("no_sync"), (), "check the cable"),
    "trigger cable loose": RunMistake(_lamp("sync_weak"), kinds.WEAK, "cable"),
    "sync inverted": RunMistake(_lamp("sync_inverted"), (), "sync signal is inverted"),
    "lamp flickers at half the frequency": RunMistake(
        _lamp("wrong_frequency", factor=0.5), (), "set to 240.000 Hz"
    ),
    "frequency of the sequence changed": RunMistake(named=(kinds.LIGHT,), light={"hz": 180.0}),
    "duty of the sequence changed": RunMistake(named=(kinds.LIGHT,), light={"duty": 20.0}),
    "duty of the lamp times 0.3": RunMistake(_lamp("wrong_duty", factor=0.3), (kinds.LIGHT,)),
    "level of the light lowered": RunMistake(_section("light", high_v=2), (kinds.LIGHT,)),
    "lamp dimmed to a tenth": RunMistake(_lamp("dim", factor=0.1), kinds.WEAK, "lamp"),
    "lamp dimmed to a quarter": RunMistake(_lamp("dim", factor=0.25), kinds.WEAK),
    "lamp dimmed to a half": RunMistake(_lamp("dim", factor=0.5), kinds.WEAK),
    "laptop slept while the stage turned": RunMistake(named=(kinds.ASLEEP,), asleep="slewing"),
    "laptop slept in a recording": RunMistake(named=(kinds.ASLEEP,), asleep="recording"),
    "knocked by 0.3 degrees in the run": RunMistake(
        named=(of_views.TURNED,), order={"device": "mount", "fault": "turn", "pan_deg": 0.2, "tilt_deg": 0.2}
    ),
    "ring turned by 3 degrees in the run": RunMistake(
        named=(of_views.FOCUSED,), order={"device": "lens", "fault": "turn", "deg": 3.0}
    ),
    "camera creeps in its mount": RunMistake(
        _simulation("mount", drift_arcsec_per_min=[900.0, 300.0]), (of_views.CREEPS,)
    ),
    "fog on the lens": RunMistake(_simulation("optics", psf_px=2.0), (), "fog"),
    "camera upside down": RunMistake(
        _simulation("optics", mounting_deg=[0.2, -0.1, 170.0])
    ),  # which is right
    "negative of the print": RunMistake(_simulation("reticle", polarity="negative")),  # which is right
}


def _station() -> Station:
    text = (SHIPPED_STATIONS / "simulated.yaml").read_text(encoding="utf-8")
    station: Station = yaml.safe_load(text)
    station["simulation"] |= {"ports": "pty", "paced": False, "camera": dict(SMALL), "camera_seed": 4}
    for axis in station["stage"]["axes"].values():
        axis |= {"speed_deg_s": 90, "acceleration_deg_s2": 2000}
    station["expected"] |= {"focal_px": 1672, "image_size": [640, 360]}
    station["camera"]["serial"] = "00050423"
    return station


def _words(folder: Path, station: Station, light: Mapping[str, float], seed: int) -> list[Any]:
    """Write sequence and station to a folder; return the command that runs them."""
    folder.mkdir(parents=True)
    sequence, path = folder / "five.yaml", folder / "station.yaml"
    sequence.write_text(SEQUENCE % {"hz": 240.0, "duty": 50.0, **light})
    path.write_text(yaml.safe_dump(station, sort_keys=False))
    return ["run", sequence, "-s", path, "--seed", seed]


class _Hand:
    """Gives an order to the simulated bench when its run begins to turn to a pose."""

    def __init__(self, folder: Path, pose: int, order: Mapping[str, Any]) -> None:
        self._folder, self._pose, self._order = folder, pose, json.dumps(dict(order))
        self._benches: list[SimulatedBench] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Self:
        made = SimulatedBench.__init__

        def keep(bench: SimulatedBench, *given: Any, **named: Any) -> None:
            made(bench, *given, **named)
            self._benches.append(bench)

        self._patch = mock.patch.object(SimulatedBench, "__init__", keep)
        self._patch.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._patch.stop()

    def _watch(self) -> None:
        while not self._ended.wait(0.01):
            if self._benches and _entered(self._folder, "slewing") >= self._pose:
                self._benches[0].order(self._order)
                return


def _entered(folder: Path, state: str) -> int:
    return sum(line["event"] == "entering" and line["state"] == state for line in journal(folder))


def _run(folder: Path, home: Path, words: list[Any], mistake: RunMistake) -> tuple[int, str]:
    """Run as an operator does, into a folder; return the exit code and what is told."""
    words = [*words, "-o", folder]
    if mistake.asleep:
        process = start(*words, home=home)
        while process.poll() is None and _entered(folder, mistake.asleep) < 3:
            time.sleep(0.005)
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(ASLEEP_S)
        os.kill(process.pid, signal.SIGCONT)
        out, err = process.communicate()
        return process.returncode, out + err
    if mistake.order:
        with _Hand(folder, 3, mistake.order):
            done = called(*words, home=home, status=None)
    else:
        done = called(*words, home=home, status=None)
    return done.returncode, done.stdout + done.stderr


def mistaken_run(name: str, seed: int) -> dict[str, Any]:
    """Run a bench with a mistake after a healthy run of it; ``healthy`` for none. Columns as of `mistaken`."""
    mistake = RUN_MISTAKES.get(name, RunMistake())
    line: dict[str, Any] = {"mistake": name, "seed": seed}
    with tempfile.TemporaryDirectory(prefix="mistaken-") as made:
        base = Path(made)
        home, folder = _healthy_before(base, seed), base / "run"
        station = _station()
        mistake.change(station)
        code, output = _run(folder, home, _words(base / "files", station, mistake.light or {}, seed), mistake)
        # What rests on an earlier run stands in the journal, and not in the results.
        solved = [entry for entry in journal(folder) if entry["event"] == "solved"]
        if solved:
            output = called("status", folder, home=home, status=None).stdout
    if code or not solved:
        right = bool(mistake.refused and re.search(mistake.refused, output, re.DOTALL))
        return {**line, "causes": [], "told": [output], "right": right, "wrong": not right}
    causes = solved[-1]["causes"]
    first = {causes[0]["kind"], *causes[0]["beside"]} if causes else set()
    right = bool(first & set(mistake.named)) if mistake.named else not causes and not mistake.refused
    wrong = bool(causes) and not right
    kinds = [cause["kind"] for cause in causes]
    return {**line, "causes": kinds, "told": [output], "right": right, "wrong": wrong}


def _healthy_before(base: Path, seed: int) -> Path:
    """Make a healthy run of a bench, once a seed; return a copy of the home that has it, in a folder of one's own."""
    kept = EARLIER_RUNS / str(seed)
    if not (kept / "run" / RESULTS).exists():
        shutil.rmtree(kept, ignore_errors=True)
        words = _words(kept / "files", _station(), {}, seed + EARLIER)
        called(*words, "-o", kept / "run", home=kept / "home")
    return Path(shutil.copytree(kept / "home", base / "home"))
