"""A sealed run of the simulated bench, made once, and copies of it that can be changed and sealed again."""

import io
import json
import os
from unittest import mock

import pytest
from quick_runs import write_sequence, write_station

from bench.base.clock import BenchClock
from bench.base.home import HOME_VARIABLE
from bench.evidence.keys import load_key
from bench.evidence.signers import read_signers
from bench.plan.job import Job
from bench.report import figures
from bench.run.launch import Launch, start_run
from tests.unit.bench.evidence.attack_steps import copied
from tests.unit.bench.evidence.resealed import Forger

POSES = (
    "[{name: left, pan_deg: -6, tilt_deg: 2}, {name: right, pan_deg: 6, tilt_deg: 2},"
    " {name: below, pan_deg: 0, tilt_deg: -3}]"
)
CERTIFICATE = (
    "nominal_r_mm: 255, certificate: {number: C-7, r_mm: 255, uncertainty_mm: 0.1, date: 2026-01-12}}"
)


@pytest.fixture(scope="module")
def drawn_once():
    """Plots of the same results and stars are drawn once: it takes a second."""
    draw, drawn = figures.report_plots, {}

    def report_plots(results, views):
        stars = b"".join(view.detected.tobytes() + view.residuals.tobytes() for view in views)
        key = json.dumps(results), stars
        if key not in drawn:
            drawn[key] = draw(results, views)
        return drawn[key]

    with mock.patch("bench.report.figures.report_plots", report_plots):
        yield


@pytest.fixture(scope="session")
def bench_home(tmp_path_factory):
    return tmp_path_factory.mktemp("bench")


@pytest.fixture(scope="session")
def run_once(tmp_path_factory, bench_home):
    """A sealed run of a simulated bench, not to be touched."""
    folder = tmp_path_factory.mktemp("attacked")
    station = write_station(folder / "station.yaml")
    text = station.read_text()
    assert "nominal_r_mm: 255}" in text
    station.write_text(text.replace("nominal_r_mm: 255}", CERTIFICATE))
    sequence = write_sequence(folder / "sequence.yaml", POSES, attempts=1)
    launch = Launch(BenchClock(), stream=io.StringIO())
    with mock.patch.dict(os.environ, {HOME_VARIABLE: str(bench_home)}):
        end = start_run(
            str(sequence), str(station), output=folder / "run", seed=1, operator="Ada", launch=launch
        )
    assert end.how == "finished", end.why
    return folder / "run"


@pytest.fixture(scope="session")
def bench_key(run_once, bench_home):
    return load_key(bench_home)


@pytest.fixture(scope="session")
def trusted(run_once, bench_home):
    return read_signers(bench_home / "allowed_signers")


@pytest.fixture(scope="session")
def job(run_once):
    return Job.from_run_folder(run_once, seed=1, operator="Ada")


@pytest.fixture
def forger(run_once, bench_key, tmp_path):
    """A copy of the run, and the key to seal it again."""
    return Forger(copied(run_once, tmp_path / "run"), bench_key)
