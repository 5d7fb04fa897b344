"""What every test may ask for."""

import gc
import os
import signal
from collections.abc import Generator
from pathlib import Path

# Before numpy is loaded: on small matrices, threads of the linear algebra cost three times what they gain, and the
# tests already fill the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import settings

from bench.base.kernel_cache import remove_stale_kernels
from drivers.lateness import Lateness

# What collecting makes stays to the end: a search for cycles among it would take a fifth of the time of each worker.
gc.disable()

# A shell starts background jobs (`make test &`) with SIGINT ignored, and so would every process that a test starts.
# Tests of Ctrl-C rely on Python's own handler.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # under nohup: what a test starts does not ignore it
    signal.signal(signal.SIGHUP, lambda *_: None)

# No test is timed: machines are shared, and the first call of a compiled function takes seconds.
settings.register_profile("starbench", deadline=None)
settings.load_profile("starbench")


def pytest_configure(config: pytest.Config) -> None:
    """Kernels that name a module of an earlier version cannot be loaded: they go, as when a command begins."""
    if not hasattr(config, "workerinput"):
        remove_stale_kernels()


LONG_S = 0.25
"""A test that took more when it last ran on this computer has the mark `long`."""
_LONG_TESTS = "starbench/long"
_took_s: dict[str, float] = {}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that were long; those that never ran here are not known to be."""
    cache = getattr(config, "cache", None)  # None with -p no:cacheprovider
    long_tests = set(cache.get(_LONG_TESTS, [])) if cache else set()
    for item in items:
        if item.nodeid in long_tests:
            item.add_marker("long")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up the time of a test, with what is made for it."""
    _took_s[report.nodeid] = _took_s.get(report.nodeid, 0.0) + report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep the names of long tests; the first of several processes hears of those of all."""
    cache = getattr(session.config, "cache", None)
    if cache and not hasattr(session.config, "workerinput"):
        before = set(cache.get(_LONG_TESTS, [])) - _took_s.keys()
        now = {name for name, took_s in _took_s.items() if took_s > LONG_S}
        cache.set(_LONG_TESTS, sorted(before | now))


def pytest_collection_finish() -> None:
    """From here on Python looks for cycles again, among new objects."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Only the product is searched for doctests: each worker would import every helper of the tests, too."""
    return [file for file in (yield) if not isinstance(file, DoctestModule)]


@pytest.fixture
def never_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deadlines grow by how late a busy computer wakes this process, which a virtual clock must not know of."""
    still = Lateness(now_s=lambda: 0.0)
    monkeypatch.setattr("drivers.lateness.own_lateness", lambda: still)


EVK4_RECORDING = Path(__file__).parent / "data" / "evk4_real" / "imx636_1280x720_two_triggers.raw"


@pytest.fixture(scope="session")
def evk4_recording() -> Path:
    """A recording of a real EVK4, published under Apache-2.0 (tests/data/README.md)."""
    return EVK4_RECORDING


@pytest.fixture(scope="session")
def collimator_recordings() -> Path:
    """Folder of 20 views of a real collimator. They were published without a licence, so they are not in the project."""
    shared_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STARBENCH_REFERENCE_DATA", shared_data)) / "collimator_real"
    if not folder.is_dir():
        pytest.skip(
            "the published collimator recordings have no licence and are not in the project; "
            "tests/data/README.md says where they come from, STARBENCH_REFERENCE_DATA names their folder"
        )
    return folder
