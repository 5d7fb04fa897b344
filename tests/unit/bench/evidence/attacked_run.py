"""A sealed run of the simulated bench to be attacked; and what is made again is made once for the same input."""

import io
import os
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

from quick_runs import THREE_NAMED, write_sequence, write_station

from bench.base.bounded_json import canonical_json
from bench.base.clock import BenchClock
from bench.base.home import HOME_VARIABLE
from bench.measure.camera_kinds import EventKind
from bench.report import plots
from bench.run.launch import Launch, start_run
from bench.solve.solution import solve_run
from bench.stations.devices import simulated_truth
from bench.wording.target_words import words_of

CERTIFICATE = (
    "nominal_r_mm: 255, certificate: {number: C-7, r_mm: 255, uncertainty_mm: 0.1, date: 2026-01-12}}"
)
#: A method of reference would use no passport.
END = "  - solve: {distortion: [k1]}\n  - report\n"
KEPT = {"drawn": {}, "measured": {}, "solved": {}, "truth": {}}
PASSPORT = "passport.json"


@contextmanager
def kept_in_memory():
    """Plots, stars of a recording and calibrations are made once for the same input."""
    draw, measure, solve, truth = plots.report_plots, EventKind.measure, solve_run, simulated_truth

    def once(kind, key, make):
        if key not in KEPT[kind]:
            KEPT[kind][key] = make()
        return KEPT[kind][key]

    def report_plots(results, views):
        stars = b"".join(view.detected.tobytes() + view.residuals.tobytes() for view in views)
        shown = [results["calibration"], results.get("previous"), repr(words_of(results))]
        return once("drawn", (canonical_json(shown), stars), lambda: draw(results, views))

    def measure_one(kind, path, step, frequency_hz, target, expected_grid, **more):
        def make():
            return measure(kind, path, step, frequency_hz, target, expected_grid, **more)

        if expected_grid is not None:  # a function, which says nothing of what it returns
            return make()
        elsewhere = replace(step, where="")  # each copy of the run lies in another folder
        return once("measured", (path.read_bytes(), repr((elsewhere, frequency_hz, target, more))), make)

    def solve_one(job, folder, step, history, measured):
        # What nothing is calculated from is left out: the folder, the station's name, and the other steps.
        station = job.station.model_copy(update={"name": ""})
        kept = (replace(step, where=""), station, (folder / PASSPORT).read_bytes())
        images = [(index, pose.image.decoded().tobytes()) for index, pose in sorted(measured.items())]
        states = [pose.stored["measured_deg"] for _, pose in sorted(history.accepted().items())]
        key = repr((kept, images, states, history.started["sequence"], history.started_utc[:10]))
        return once("solved", key, lambda: solve(job, folder, step, history, measured))

    def read_truth(station, seed):
        return once("truth", repr((station, seed)), lambda: truth(station, seed))

    with (
        mock.patch("bench.report.plots.report_plots", report_plots),
        mock.patch("bench.again.run.simulated_truth", read_truth),
        mock.patch.object(EventKind, "measure", measure_one),
        mock.patch("bench.again.run.solve_run", solve_one),
    ):
        yield


def make_run(folder, home):
    """Make a sealed run on a bench whose home is ``home``; return its folder."""
    station = write_station(folder / "station.yaml")
    text = station.read_text()
    assert "nominal_r_mm: 255}" in text
    station.write_text(text.replace("nominal_r_mm: 255}", CERTIFICATE))
    sequence = write_sequence(folder / "sequence.yaml", THREE_NAMED, attempts=1, end=END)
    launch = Launch(BenchClock(), stream=io.StringIO())
    words = {"output": folder / "run", "seed": 1, "operator": "Ada", "launch": launch}
    with mock.patch.dict(os.environ, {HOME_VARIABLE: str(home)}):
        end = start_run(str(sequence), str(station), **words)
    assert end.how == "finished", end.why
    return folder / "run"
