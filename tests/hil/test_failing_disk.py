"""A disk whose writes and syncs fail at random, in a real process: bounded, told in words, safe, and nothing stored is lost."""

import hashlib

import pytest
from failing_calls import build_library
from quick_runs import THREE_NAMED, quick_words
from running import STARBENCH, environment, journal, python, starbench


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """The library that lets file operations fail, compiled."""
    library = build_library(tmp_path_factory.mktemp("shim"))
    if library is None:
        pytest.skip("needs Linux and a C compiler")
    return library


def run_on_failing_disk(shim, tmp_path, what, probability, seed):
    failing = {
        "LD_PRELOAD": shim,
        "FAILING_KIND": what,
        "FAILING_PROBABILITY": probability,
        "FAILING_FOLDER": tmp_path / "run",
        "FAILING_SEED": seed,
    }
    words = quick_words(tmp_path, THREE_NAMED)
    return python(*STARBENCH[1:], *words, status=None, **environment(tmp_path / "home") | failing)


def stored(folder):
    """Hashes that the journal tells of its recordings."""
    return {line["capture"]: line["sha256"] for line in journal(folder) if line["event"] == "capture_stored"}


def hashes(folder, names):
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("what", "probability"), [("write", 0.004), ("sync", 0.03)])
def test_a_run_on_a_failing_disk_ends_in_words_and_is_finished_on_a_good_one(
    shim, tmp_path, what, probability, seed
):
    folder, home = tmp_path / "run", tmp_path / "home"
    ended = run_on_failing_disk(shim, tmp_path, what, probability, seed)
    assert "Traceback" not in ended.stderr + ended.stdout, ended.stderr
    assert ended.returncode in {0, 1}, ended.stderr
    if ended.returncode == 0:  # what failed did not matter
        starbench("verify", folder, home=home)
        return
    assert "Input/output error" in ended.stderr
    assert "CHECK THE BENCH" not in ended.stderr
    recorded = stored(folder)
    assert hashes(folder, recorded) == recorded
    resumed = starbench("resume", folder, home=home, status=None)
    if not journal(folder):  # it failed before its first line
        assert resumed.returncode == 2  # it is no run folder
        assert "Traceback" not in resumed.stderr
        return
    assert resumed.returncode == 0, ended.stderr + resumed.stderr
    assert recorded.items() <= stored(folder).items()
    assert hashes(folder, recorded) == recorded
    starbench("verify", folder, home=home)
