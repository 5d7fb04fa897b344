"""A crash is counted exactly once, at whatever moment the process dies."""

from types import SimpleNamespace

import pytest
from journals import CLOCK

from bench.base.clock import BenchClock
from bench.record.events import Event
from bench.record.history import replay
from bench.record.journal import Journal, read_journal
from bench.record.run_folder import RunFolder
from bench.run import launch
from bench.run.crash_log import CRASH_LOG, write_crash_log
from bench.run.launch import Launch, resume_run
from bench.run.runner import RunEnd


@pytest.fixture
def crashed(tmp_path, monkeypatch):
    """A run whose process crashed at its first pose; what follows its resuming is left out."""
    with (
        RunFolder.create(tmp_path / "run") as folder,
        Journal.create(folder.journal_path, CLOCK) as journal,
    ):
        journal.append(Event.RUN_STARTED, id="run", ledger={"number": 1})
        journal.append(Event.ENTERING, state="slewing", pose=1)
    write_crash_log(tmp_path / "run", "Fatal Python error: Segmentation fault")
    job = SimpleNamespace(station=SimpleNamespace(needs_simulated_bench=False))
    monkeypatch.setattr(launch, "job_of", lambda _folder, entries: (job, replay(entries)))
    monkeypatch.setattr(launch, "run_software", lambda _station: {})
    monkeypatch.setattr(launch, "intentions", lambda *_: [])
    monkeypatch.setattr(
        launch, "ledger_of", lambda _: SimpleNamespace(home=tmp_path / "home", end=lambda *_, **__: None)
    )
    monkeypatch.setattr(launch, "enter_in_ledger", lambda _ledger, _job, _folder, known: known)
    monkeypatch.setattr(
        launch, "run_and_seal", lambda *_, **__: RunEnd("finished", "", tmp_path / "run", None)
    )
    return tmp_path / "run"


def resume(folder):
    return resume_run(folder, Launch(BenchClock()))


def crashes(folder):
    return replay(read_journal(folder / "journal.jsonl")[0]).crashes


@pytest.mark.parametrize("after", [False, True])
def test_a_death_while_archiving_neither_loses_nor_doubles_the_crash(crashed, monkeypatch, after):
    real = launch.archive_crash

    def died(folder):
        if after:
            real(folder)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(launch, "archive_crash", died)
        with pytest.raises(KeyboardInterrupt):
            resume(crashed)
    resume(crashed)
    assert crashes(crashed) == {1: 1}
    assert not (crashed / CRASH_LOG).exists()
