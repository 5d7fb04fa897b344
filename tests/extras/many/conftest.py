"""A cluster of two workers."""

import os
import sys

import pytest


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Let workers import what the tests import."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(folder for folder in sys.path if folder))


@pytest.fixture
def cluster(tmp_path):
    distributed = pytest.importorskip("distributed")
    made = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        local_directory=str(tmp_path),
    )
    yield made
    made.close(timeout=5)
