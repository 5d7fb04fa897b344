"""Runs behind a URL give what the same runs give on a disk; what cannot be read is told."""

import json
import threading
from pathlib import Path

import pytest
from solved_run import write_solved_run

from bench.base.errors import StorageError, UsageError
from bench.base.program import forms
from bench.measure.views_file import read_views
from bench.record.storage import sha256_of
from bench.solve.offline_options import OfflineOptions
from bench.work.places import Place, find_places
from bench.work.recalculation import listed_ahead
from bench.work.tasks import FoundView, Task, calibrate_found, list_recordings

fsspec = pytest.importorskip("fsspec")
TASK = Task(OfflineOptions(), forms()["program"], kept="")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_solved_run(tmp_path_factory.mktemp("solved"))


@pytest.fixture
def remote(run):
    """URL of a folder with two copies of a run."""
    url, system = "memory://bench", fsspec.filesystem("memory")
    for name in ("run2", "run10"):
        system.put(str(run), f"{url}/{name}", recursive=True)
    yield url, system
    system.rm("/bench", recursive=True)


def found_views(folder):
    """The views of a run, as if they had been found in its recordings."""
    names = list_recordings(Place(str(folder)), TASK).captures
    return [
        FoundView(stored.view, (folder / name).stat().st_size, sha256_of(folder / name))
        for stored, name in zip(read_views(folder / "views.h5"), names, strict=True)
    ]


def test_a_run_behind_a_url_gives_what_it_gives_on_a_disk(remote, run, monkeypatch):
    monkeypatch.setattr("bench.solve.result.render_report", lambda _data: "<!DOCTYPE html>")
    url, _ = remote
    places = find_places([url, f"{url}/run2"])
    assert [place.name for place in places] == [f"{url}/run2", f"{url}/run10"]
    here = Place(str(run))
    assert list_recordings(places[0], TASK) == list_recordings(here, TASK)
    capture = list_recordings(here, TASK).captures[1]
    with places[0].folder(capture) as copy:
        assert (copy / capture).read_bytes() == (run / capture).read_bytes()
        assert sorted(path.name for path in (copy / "captures").iterdir()) == [Path(capture).name]
        assert not (copy / "report.html").exists()
    assert not copy.exists()
    far, near = (
        calibrate_found(place, found_views(run), "again", None, TASK, True) for place in (places[0], here)
    )
    assert {**far.row, "results_sha256": 0} == {**near.row, "results_sha256": 0}
    assert far.files["views.h5"] == near.files["views.h5"]
    results = [json.loads(run.files["results.json"]) for run in (far, near)]
    assert results[0]["sources"][0]["path"] == f"{url}/run2/{list_recordings(here, TASK).captures[0]}"
    assert results[0]["run"]["of_runs"][0]["folder"] == f"{url}/run2"
    assert results[0]["calibration"] == results[1]["calibration"]
    assert "starbench-" not in far.files["results.json"].decode() + far.files["sources.json"].decode()


def test_runs_behind_a_url_are_listed_ahead_in_their_order(monkeypatch):
    listed, together = [], threading.Barrier(8, timeout=5)

    def list_one(place, _task):
        together.wait()
        listed.append(place.name)
        if place.name.endswith("/3"):
            raise StorageError("gone", where=place.name)
        return place.name

    monkeypatch.setattr("bench.work.recalculation.list_recordings", list_one)
    places = [Place(f"s3://runs/{number}") for number in range(80)]
    source = listed_ahead(places, TASK)
    for number in range(16):
        at, place, listed_by = next(source)
        assert (at, place) == (number, places[number])
        if number == 3:
            with pytest.raises(StorageError, match="gone"):
                listed_by()
        else:
            assert listed_by() == place.name
    assert len(listed) <= 32
    together.abort()
    source.close()
    assert len(listed) <= 32


def test_a_url_that_is_not_there_is_told(remote):
    url, system = remote
    with pytest.raises(UsageError):
        find_places([f"{url}/none"])
    system.pipe_file(f"{url}/photos/left.png", b"")
    with pytest.raises(UsageError, match="only folders of runs"):
        find_places([f"{url}/photos"])
    place = Place(f"{url}/run2")
    system.rm(f"{url}/run2", recursive=True)
    with pytest.raises((UsageError, StorageError), match="run2"), place.folder():
        pass


def test_a_name_that_leaves_the_run_is_refused(remote):
    url, _ = remote
    with pytest.raises(StorageError, match="outside"), Place(f"{url}/run2").folder("../run10/journal.jsonl"):
        pass


def test_an_unknown_kind_of_url_is_told():
    with pytest.raises(UsageError, match="cannot be read"):
        find_places(["gopher://lab/runs"])


def test_a_file_and_nothing_are_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file, not a folder"):
        find_places([str(tmp_path / "file")])
    with pytest.raises(UsageError, match="no such folder"):
        find_places([str(tmp_path / "none")])


def test_without_fsspec_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "fsspec.core", None)
    with pytest.raises(UsageError, match=r"starbench\[cluster\]"):
        find_places(["s3://bench"])
