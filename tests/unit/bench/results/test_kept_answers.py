"""Answers of `calibrate` are kept until anything that decides them changes; a run keeps its own views."""

import shutil
from datetime import datetime
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from solved_run import write_solved_run

from bench.commands import calibrate_command
from bench.commands.cli import cli
from bench.plan.job import Job
from bench.records.history import replay
from bench.records.journal import read_journal
from bench.records.run_folder import PASSPORT_COPY
from bench.results import kept_answers
from bench.results.keep_views import keep_views_of_run
from bench.results.kept_answers import KeptAnswers, answer_key
from bench.results.offline import with_kept_views
from bench.results.offline_options import OfflineOptions
from bench.results.view_sources import view_sources
from bench.views.kept_views import KeptViews, pack_view
from bench.views.measure import Measurement
from bench.views.views_file import read_views


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    folder = tmp_path / "run"
    (folder / "captures").mkdir(parents=True)
    (folder / "journal.jsonl").write_text("{}\n")
    (folder / "captures" / "one.raw").write_bytes(b"events")
    return folder


def test_the_key_covers_every_file_the_options_and_the_program(run, monkeypatch):
    keys = {answer_key([run], {"model": None})}
    assert answer_key([run], {"model": None}) in keys
    keys.add(answer_key([run], {"model": "radial"}))
    (run / "captures" / "one.raw").write_bytes(b"Events")
    keys.add(answer_key([run], {"model": None}))
    (run / "station.yaml").write_text("")
    keys.add(answer_key([run], {"model": None}))
    monkeypatch.setattr(kept_answers, "forms", lambda: {"program": "newer"})
    keys.add(answer_key([run], {"model": None}))
    assert len(keys) == 5
    assert None not in keys
    assert answer_key([run], {"passport": "file.json"}) is None
    assert answer_key([run / "captures" / "one.raw"], {}) is None


def test_a_large_file_that_was_never_written_is_not_hashed(run, monkeypatch):
    monkeypatch.setattr(kept_answers, "sha256_of", lambda path: str(path.stat().st_size))
    with (run / "captures" / "two.raw").open("wb") as file:
        file.truncate(99_000_000)
        assert answer_key([run], {}) is not None
        file.truncate(10_000_000_000)
    assert answer_key([run], {}) is None


def test_an_answer_holds_on_other_days_unless_a_passport_can_expire(run, monkeypatch):
    def keys():
        found = []
        for day in (1, 2):

            class Then(datetime):
                @classmethod
                def now(cls, tz=None, day=day):
                    return datetime(2026, 11, day, tzinfo=tz)

            monkeypatch.setattr(kept_answers, "datetime", Then)
            found.append(answer_key([run], {}))
        return found

    first, second = keys()
    assert first == second
    (run / PASSPORT_COPY).write_text("{}")
    first, second = keys()
    assert first != second


def test_a_changed_answer_is_calculated_again_and_told(run):
    answers, key = KeptAnswers.of_bench(), "ab" * 32
    answers.keep(key, "fx 3345 ± 1 px\n", "{}\n")
    assert KeptAnswers.of_bench().answer(key, as_json=False) == "fx 3345 ± 1 px\n"
    assert KeptAnswers.of_bench().answer(key, as_json=True) == "{}\n"
    (entry,) = answers.folder.glob("*/*.json")
    entry.write_bytes(entry.read_bytes().replace(b"3345", b"3346"))
    assert answers.answer(key, as_json=False) is None
    assert "it is calculated again" in answers.remarks[0]
    assert not entry.exists()


def test_the_command_calculates_once(run, monkeypatch):
    calls = []

    def calculated(paths, **_):
        calls.append(paths)
        return SimpleNamespace(skipped=())

    def printed(_result, *, compare, as_json):
        return f"answer, JSON {as_json}, compared {compare}\n"

    monkeypatch.setattr(calibrate_command, "_calculated", calculated)
    monkeypatch.setattr(calibrate_command, "_printed", printed)

    def say(*words):
        return CliRunner().invoke(cli, ["calibrate", str(run), *words], standalone_mode=False).stdout

    assert {say(), say(), say()} == {"answer, JSON False, compared False\n"}
    assert say("--json") == "answer, JSON True, compared False\n"
    assert len(calls) == 1
    say("--find-again")
    assert say("--compare") == "answer, JSON False, compared True\n"
    assert len(calls) == 3
    (run / "captures" / "one.raw").write_bytes(b"other")
    say()
    assert len(calls) == 4


def keep_views(folder):
    """Keep the views of a run, as its end does; return them."""
    job = Job.from_run_folder(folder)
    history = replay(read_journal(folder / "journal.jsonl")[0])
    views = [stored.view for stored in read_views(folder / "views.h5")]
    measured = {
        index: Measurement(view, None, {})
        for index, view in zip(sorted(history.accepted()), views, strict=True)
    }
    assert keep_views_of_run(job, history, measured) == len(views) == 4
    return views


def test_a_run_keeps_its_views(tmp_path):
    folder = write_solved_run(tmp_path)
    views = keep_views(folder)
    kept = KeptViews.of_bench()
    read = [with_kept_views(source, kept).read() for source in view_sources(folder, OfflineOptions())]
    assert (kept.used, kept.found) == (4, 0)
    assert [pack_view(view, "0") for view in read] == [pack_view(view, "0") for view in views]


def test_a_finished_run_leaves_the_answer_of_calibrate(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    folder = write_solved_run(tmp_path)
    keep_views(folder)
    answers = KeptAnswers.of_bench().folder

    def say(path):
        return [
            CliRunner().invoke(cli, ["calibrate", str(path), *words], standalone_mode=False).stdout
            for words in ((), ("--json",))
        ]

    calculated = say(folder)
    assert "fx" in calculated[0]
    shutil.rmtree(answers)
    with monkeypatch.context() as limit:
        limit.setattr(calibrate_command, "MOST_RUN_BYTES", 0)
        calibrate_command.keep_answer_of_run(folder)
    assert not answers.exists()
    calibrate_command.keep_answer_of_run(folder)
    assert answers.exists()
    monkeypatch.setattr(calibrate_command, "_calibrated", lambda *_, **__: pytest.fail("calculated again"))
    monkeypatch.chdir(folder.parent)
    assert say(folder.name) == calculated
