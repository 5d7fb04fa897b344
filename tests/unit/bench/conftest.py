"""A small sealed run, and a key to seal it with."""

import hashlib
import os
import subprocess
from pathlib import Path

import pytest
from expected_stars import THREE, expected_views, write_points
from journals import CLOCK
from kept_calibrations import kept_calibration

from bench.base.bounded_json import canonical_json
from bench.evidence.keys import create_key, load_key
from bench.evidence.seal import seal
from bench.evidence.signers import read_signers
from bench.measure.kept_views import KeptViews
from bench.record.journal import CAPTURE_STORED, Journal, capture_name
from bench.record.ledger import Ledger
from bench.record.run_folder import RunFolder
from tests.unit.bench.evidence.resealed import copied


@pytest.fixture
def synced(monkeypatch):
    """What is synced from here on, in order: the paths given to fsync."""
    paths = []
    real = os.fsync

    def fsync(descriptor):
        paths.append(Path(f"/proc/self/fd/{descriptor}").readlink())
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return paths


@pytest.fixture
def children(monkeypatch):
    """The processes that are started from here on."""
    started, real = [], subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: started.append(real(*a, **k)) or started[-1])
    return started


@pytest.fixture(scope="session")
def points(tmp_path_factory):
    """Point files of three views of the bench that the simulated station expects, with every third star."""
    return write_points(
        tmp_path_factory.mktemp("points"), expected_views(THREE, sigma_px=0.01, seed=5), every=3
    )


@pytest.fixture
def calibrated_once(monkeypatch):
    """The same views with the same options are calibrated once, for all tests that ask for this."""
    monkeypatch.setattr("bench.solve.solution.calibrate", kept_calibration)


@pytest.fixture
def coarse(monkeypatch):
    """The next pose is chosen on a coarse grid, which is not refined."""
    monkeypatch.setattr("bench.solve.next_pose.GRID", {"pan_deg": 5, "tilt_deg": 5, "roll_deg": 3})
    monkeypatch.setattr("bench.solve.next_pose.REFINEMENTS", ())


@pytest.fixture
def ledger(tmp_path):
    return Ledger(tmp_path / "home", CLOCK)


@pytest.fixture(scope="session")
def home(tmp_path_factory):
    """A configuration folder with a key in it."""
    folder = tmp_path_factory.mktemp("home")
    create_key(folder, principal="bench1@lab.example")
    return folder


@pytest.fixture(scope="session")
def key(home):
    return load_key(home)


@pytest.fixture(scope="session")
def signers(home):
    return read_signers(home / "allowed_signers")


def write_report(folder, journal, poses, serial):
    results = {
        "run": {"id": "run-1", "simulated": True},
        "devices": {"camera": {"serial": serial}},
        "poses": poses,
    }
    files = {"results.json": canonical_json(results), "exports/opencv.yaml": b"fx: 3345.06\n"}
    files |= {name: name.encode() for name in ("report.html", "views.h5")}
    for name, data in files.items():
        folder.write_atomic(name, data)
    journal.append("entering", state="reporting")
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    journal.append("written", head=journal.entries[-1].hash, files=hashes)
    journal.append("left_off", state="reporting")


def make_a_run(path, *, serial="00050423", reported=True):
    """Make a run of two poses, one of them with two attempts; returns the folder, held, its journal closed."""
    folder = RunFolder.create(path)
    poses = []
    documents = {name: f"{name} of a run\n".encode() for name in ("sequence.yaml", "station.yaml")}
    documents |= {"plan.json": b"{}\n"}
    for name, text in documents.items():
        folder.write_atomic(name, text)
    with Journal.create(folder.journal_path, CLOCK) as journal:
        hashes = {name: hashlib.sha256(text).hexdigest() for name, text in documents.items()}
        journal.append("run_started", id="run-1", sha256=hashes)
        for pose, attempts in ((1, 2), (2, 1)):
            recorded = []
            for attempt in range(1, attempts + 1):
                name = capture_name(pose, attempt)
                folder.part_path(name).write_bytes(f"recording {pose} {attempt}".encode())
                capture = folder.commit(name)
                which = {"pose": pose, "pose_name": str(pose), "attempt": attempt}
                journal.append(CAPTURE_STORED, **which, **capture.as_data())
                recorded.append({"attempt": attempt, "capture": capture.name, "sha256": capture.sha256})
            poses.append({"index": pose, "attempts": recorded})
        if reported:
            write_report(folder, journal, poses, serial)
        journal.append("run_ended", how="finished", why="")
    return folder


@pytest.fixture(scope="session")
def make_run():
    """What makes a run, as yet unsealed, in a given folder."""
    return make_a_run


@pytest.fixture(scope="session")
def sealed_once(tmp_path_factory, key):
    """A sealed run, not to be touched."""
    path = tmp_path_factory.mktemp("runs") / "sealed"
    with make_a_run(path) as folder:
        seal(folder, key)
    return path


@pytest.fixture
def sealed(sealed_once, tmp_path):
    """A sealed run that a test may tamper with."""
    return copied(sealed_once, tmp_path / "sealed")


@pytest.fixture(autouse=True)
def own_kept_views(tmp_path, monkeypatch):
    """No test keeps views in the folder of this computer's bench, or takes them from there."""
    monkeypatch.setattr(
        "bench.measure.kept_views.KeptViews.of_bench", lambda: KeptViews(tmp_path / "kept-views")
    )
