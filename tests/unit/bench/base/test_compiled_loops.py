"""Loops are compiled by programs of their own, once, and only where they are used."""

import os

import pytest
from filled_stations import filled

from bench.base import compiled_loops
from bench.base.clock import BenchClock
from bench.base.compiled_loops import SIMULATOR, STARS, compile_loops
from bench.base.errors import UsageError
from bench.base.kernel_cache import VARIABLE
from bench.run.launch import Launch, start_run
from bench.stations.station import SHIPPED_STATIONS


@pytest.fixture
def told(tmp_path, monkeypatch, capsys):
    """What a new process tells that wants the loops of these programs; no process has compiled any before."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "not yet made"))
    source = tmp_path / "source.py"
    source.touch()
    monkeypatch.setattr(compiled_loops, "kernel_sources", lambda: iter([source]))

    def told(*programs):
        compile_loops.cache_clear()
        compile_loops(*programs)
        return capsys.readouterr().err

    yield told
    compile_loops.cache_clear()


def test_a_program_compiles_once_until_a_source_changes(told, tmp_path):
    assert "this: compiled" in told("this")
    assert told("this") == ""
    os.utime(tmp_path / "source.py", (1, 1))
    assert "this: compiled" in told("this")


def test_a_program_that_fails_is_told_and_begins_again(told):
    for _ in range(2):
        text = told("no_such_program", "this")
        assert "no_such_program: " in text
    assert "this: " not in text


class _Wanted(Exception):
    pass


@pytest.mark.parametrize(
    ("station", "programs"), [("simulated", {STARS, SIMULATOR}), ("example_evk4", {STARS})]
)
def test_a_run_wants_the_loops_of_its_station_in_a_folder_that_it_may_have(
    station, programs, tmp_path, monkeypatch
):
    def wanted(*asked):
        raise _Wanted(*asked)

    def start():
        launch = Launch(BenchClock())
        start_run("three_pose", str(path), output=tmp_path / "run", seed=1, operator=None, launch=launch)

    path = tmp_path / "station.yaml"
    path.write_text(filled((SHIPPED_STATIONS / f"{station}.yaml").read_text()))
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("bench.run.launch.compile_loops", wanted)
    for _ in range(2):  # what an interruption has left does not block the same command
        with pytest.raises(_Wanted) as caught:
            start()
        assert set(caught.value.args) == programs
    (tmp_path / "run" / "notes.txt").touch()
    with pytest.raises(UsageError, match=r"notes\.txt"):
        start()
