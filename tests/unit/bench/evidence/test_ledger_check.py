"""A sealed run against the ledger of its bench: what was taken out of the ledger, or sealed again, is noticed."""

import json
import shutil
from pathlib import Path

import pytest
from authorising import needs_certificates
from click.testing import CliRunner
from journals import CLOCK
from unchecked_seal import seal_unchecked

from bench.base.home import HOME_VARIABLE
from bench.commands.cli import cli
from bench.evidence.keys import create_key, load_key
from bench.evidence.ledger_check import is_sealed_by, ledger_faults_of_run, own_public_keys, sealed_strangers
from bench.record.events import Event
from bench.record.journal import Journal, read_journal
from bench.record.ledger import Ledger
from bench.record.run_folder import RunFolder
from bench.record.run_index import RunIndex
from tests.unit.bench.evidence.resealed import reseal, writable

SOFTWARE = {"starbench": "1"}


class Bench:
    """A bench that makes runs of one line, seals them and lists them."""

    def __init__(self, home):
        create_key(home, principal="bench1@lab.example")
        self.key, self.ledger = load_key(home), Ledger(home, CLOCK)

    def run(self, path, *, how="finished", place=None, **started):
        place = place or self.ledger.begin(run_id=path.name, folder=path, camera="1", simulated=True)
        facts = {"id": path.name, "sequence": "s", "station": "s", "sha256": {}, "seed": 1, "operator": None}
        with RunFolder.create(path) as folder:
            with Journal.create(folder.journal_path, CLOCK) as journal:
                facts |= {"simulated": True, "software": SOFTWARE, "ledger": place} | started
                journal.append(Event.RUN_STARTED, **facts)
                journal.append(Event.DEVICES, camera={"serial": "1"}, stage=[], light={}, camera_settings={})
                journal.append(Event.RUN_ENDED, how=how, why="")
            if how == "finished":
                folder.release_reserve()
                seal_unchecked(folder.path, self.key)
        self.ledger.end(place["number"], how=how, folder=path)
        RunIndex(self.ledger.home).runs([path])
        return place


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "home")


def strangers(bench):
    return bench.ledger.breaks(sealed_strangers(bench.ledger.home))[0]


@pytest.mark.parametrize("seen", ["run", pytest.param("certificate", marks=needs_certificates)])
def test_where_ledger_mark_and_index_are_gone_a_sealed_folder_beside_shows_it(
    bench, tmp_path, monkeypatch, seen
):
    place = bench.run(tmp_path / "runs" / "first")
    if seen == "certificate":
        shutil.rmtree(writable(tmp_path / "runs" / "first"))
        made = tmp_path / "certificates" / "first"
        made.mkdir(parents=True)
        run = {"id": "first", "ledger_number": place["number"], "ledger_head": place["head"]}
        (made / "certificate.json").write_text(json.dumps({"run": run}))
        seal_unchecked(made, bench.key)
    for path in [*bench.ledger.home.glob("ledger*"), *bench.ledger.home.glob("runs.sqlite3*")]:
        path.unlink()
    monkeypatch.setenv(HOME_VARIABLE, str(bench.ledger.home))
    monkeypatch.chdir(tmp_path)
    ended = CliRunner().invoke(cli, ["ledger"], standalone_mode=False)
    assert ended.return_value == 1
    assert "first" in ended.stderr


def test_a_new_bench_has_no_ledger_and_no_fault(bench, tmp_path, monkeypatch):
    monkeypatch.setenv(HOME_VARIABLE, str(bench.ledger.home))
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli, ["ledger"], standalone_mode=False).return_value == 0


def test_after_a_rollback_of_everything_here_the_sealed_runs_show_it(bench, tmp_path):
    bench.run(tmp_path / "first")
    copies = {path: path.read_bytes() for path in bench.ledger.home.glob("ledger*")}
    bench.run(tmp_path / "second")
    for path, data in copies.items():
        path.write_bytes(data)
    (fault,) = ledger_faults_of_run(tmp_path / "second", bench.ledger)
    assert "number 2" in fault
    assert [str(tmp_path / "second") in stranger for stranger in strangers(bench)] == [True]
    bench.run(tmp_path / "third", place={"number": 2, "head": "0" * 64, "of_camera": {}})
    assert len(strangers(bench)) == 2


def test_two_sealed_runs_with_one_number_are_named(bench, tmp_path):
    place = bench.run(tmp_path / "kept")
    bench.run(tmp_path / "other", place={**place, "head": "e" * 64})
    (fault,) = strangers(bench)
    assert fault.startswith(f"The sealed run {tmp_path / 'other'} ")
    assert fault.endswith("of run kept.")
    assert "number 1" in ledger_faults_of_run(tmp_path / "other", bench.ledger)[0]


def test_an_explained_break_is_no_fault_of_its_runs(bench, tmp_path):
    bench.run(tmp_path / "run")
    bench.ledger.path.unlink()
    assert ledger_faults_of_run(tmp_path / "run", bench.ledger)
    bench.ledger.explain("restored", "Ada", strangers=sealed_strangers(bench.ledger.home))
    assert ledger_faults_of_run(tmp_path / "run", bench.ledger) == []
    assert strangers(bench) == []


def test_a_run_of_another_bench_is_no_fault(bench, tmp_path):
    other = Bench(tmp_path / "elsewhere")
    other.run(tmp_path / "guest")
    RunIndex(bench.ledger.home).runs([tmp_path / "guest"])
    assert strangers(bench) == []
    assert ledger_faults_of_run(tmp_path / "guest", bench.ledger) == []


def test_whoever_names_the_key_of_this_bench_without_having_it_accuses_nobody_of_a_cut_ledger(
    bench, tmp_path
):
    bench.run(tmp_path / "run")
    copy = Path(shutil.copytree(tmp_path / "run", tmp_path / "planted"))
    planted = written_anew(bench, copy, operator="Eve")
    signature = (tmp_path / "run" / "SHA256SUMS.sig").read_bytes()
    (writable(planted) / "SHA256SUMS.sig").write_bytes(signature)
    bench.ledger.path.unlink()
    assert is_sealed_by(tmp_path / "run", own_public_keys(bench.ledger.home))
    assert not is_sealed_by(planted, own_public_keys(bench.ledger.home))
    assert ledger_faults_of_run(planted, bench.ledger) == []


def test_a_run_sealed_with_an_earlier_key_of_this_bench_is_its_own(bench, tmp_path):
    bench.run(tmp_path / "old")
    home = bench.ledger.home
    for name in ("bench_key", "bench_key.pub"):
        (home / name).unlink()
    create_key(home, principal="bench1@lab.example")
    bench.ledger.path.unlink()
    assert ledger_faults_of_run(tmp_path / "old", bench.ledger)


def test_a_folder_that_was_sealed_again_or_only_afterwards_is_noticed(bench, tmp_path):
    bench.run(tmp_path / "run")
    (writable(tmp_path / "run") / "VERIFY.txt").write_text("changed")
    reseal(tmp_path / "run", bench.key)
    assert "changed and sealed again" in ledger_faults_of_run(tmp_path / "run", bench.ledger)[0]
    bench.run(tmp_path / "failed", how="failed")
    with RunFolder.open(tmp_path / "failed") as folder:
        seal_unchecked(folder.path, bench.key)
    (fault, *_) = ledger_faults_of_run(tmp_path / "failed", bench.ledger)
    assert "failed without a seal" in fault


def written_anew(bench, path, **changed):
    """Write the journal of a run again, with other facts at its begin, and seal the run again."""
    folder = writable(path)
    (entries, _) = read_journal(folder / "journal.jsonl")
    (folder / "journal.jsonl").unlink()
    with Journal.create(folder / "journal.jsonl", CLOCK) as journal:
        for entry in entries:
            journal.append(entry.event, **(entry.data | changed if entry is entries[0] else entry.data))
    reseal(folder, bench.key)
    return folder


@pytest.mark.parametrize("journal", [None, b"", b"junk\n"])
def test_a_folder_without_a_journal_has_no_place_to_compare(bench, tmp_path, journal):
    (tmp_path / "run").mkdir()
    if journal is not None:
        (tmp_path / "run" / "journal.jsonl").write_bytes(journal)
    assert ledger_faults_of_run(tmp_path / "run", bench.ledger) == []


def test_a_copy_of_a_sealed_run_is_no_second_run(bench, tmp_path):
    bench.run(tmp_path / "run")
    shutil.copytree(tmp_path / "run", tmp_path / "copy")
    RunIndex(bench.ledger.home).runs([tmp_path / "copy", Path(tmp_path / "run")])
    assert strangers(bench) == []
    assert ledger_faults_of_run(tmp_path / "copy", bench.ledger) == []


def test_a_damaged_ledger_confirms_no_run_of_this_bench(bench, tmp_path):
    bench.run(tmp_path / "run")
    bench.ledger.path.write_bytes(b"junk\n")
    assert "does not confirm" in ledger_faults_of_run(tmp_path / "run", bench.ledger)[0]
