"""The ledger: every run is in it, however it ended, and what is taken out of it shows."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from journals import CLOCK
from running import python

from bench.base.errors import JournalBroken
from bench.evidence.seal import seal
from bench.record.journal import Journal
from bench.record.ledger import Ledger


def begin(ledger, run="run", camera="00050423", simulated=False, folder=Path("/runs/run")):
    return ledger.begin(run_id=run, folder=folder, camera=camera, simulated=simulated)


def test_a_run_is_in_it_from_its_begin_open_until_it_ends_and_then_as_it_ended_last(ledger, tmp_path):
    assert (ledger.runs(), ledger.faults()) == ([], [])
    number = begin(ledger)["number"]
    (run,) = ledger.runs()
    assert (run.number, run.run_id, run.camera, run.how, run.seal) == (1, "run", "00050423", "open", None)
    for how in ("aborted", "failed", "finished"):
        ledger.end(number, how=how, folder=tmp_path)
        assert [run.how for run in ledger.runs()] == [how]
    assert ledger.faults() == []


def test_a_run_is_known_where_it_was_entered_and_not_by_another_of_its_number_and_name(ledger, tmp_path):
    assert not ledger.entered({"number": 1})
    place = begin(ledger)
    assert ledger.entered(place).number == 1
    assert not ledger.entered({})
    other = begin(Ledger(tmp_path / "another bench", CLOCK), camera="00050999")
    assert other["number"] == place["number"]
    assert not ledger.entered(other)


def test_runs_of_a_camera_are_counted_as_they_stand(ledger, tmp_path):
    for how in ("failed", "finished", "failed", None):
        number = begin(ledger)["number"]
        if how:
            ledger.end(number, how=how, folder=tmp_path)
    begin(ledger, camera="00050999")
    begin(ledger, simulated=True)
    assert begin(ledger)["of_camera"] == {"failed": 2, "finished": 1, "open": 2}


def test_the_seal_of_a_run_is_entered_and_held_against_its_folder(ledger, make_run, key, tmp_path):
    numbers = {}
    for name in ("kept", "removed", "changed", "unsealed"):
        numbers[name] = begin(ledger, run=name, folder=tmp_path / name)["number"]
        with make_run(tmp_path / name) as folder:
            if name != "unsealed":
                seal(folder, key)
        ledger.end(numbers[name], how="finished", folder=tmp_path / name)
    assert ledger.faults() == []
    for name in ("removed", "changed"):
        (tmp_path / name / "SHA256SUMS").chmod(0o644)
        (tmp_path / name).chmod(0o755)
    (tmp_path / "removed" / "SHA256SUMS").unlink()
    (tmp_path / "changed" / "SHA256SUMS").write_bytes(b"")
    gone, changed = map(str, ledger.faults())
    assert gone.startswith("run 2 (removed): its folder ")
    assert changed.startswith("run 3 (changed)")
    assert "was changed after sealing" in changed


def test_processes_that_begin_at_once_get_numbers_of_their_own(tmp_path):
    code = (
        "import sys; from pathlib import Path; from bench.base.clock import BenchClock; from bench.record.ledger import Ledger\n"
        "ledger = Ledger(Path(sys.argv[1]), BenchClock())\n"
        "for i in range(5): print(ledger.begin(run_id='r', folder=Path('/r'), camera='c', simulated=False)['number'])"
    )

    def process(_):
        return python("-c", code, tmp_path).stdout

    with ThreadPoolExecutor(3) as pool:
        numbers = sorted(int(n) for output in pool.map(process, range(3)) for n in output.split())
    assert numbers == list(range(1, 16))
    assert len(Ledger(tmp_path, CLOCK).runs()) == 15


@pytest.mark.parametrize(
    ("event", "data"),
    [
        ("run_begun", {"run": "x"}),
        ("run_ended", {"number": 7, "how": "finished", "seal": None}),
        ("run_ended", {"number": 0, "how": "finished", "seal": None}),
        ("run_ended", {"number": "1", "how": "finished", "seal": None}),
    ],
)
def test_a_ledger_of_another_program_is_refused(ledger, event, data):
    begin(ledger)
    with Journal.open(ledger.path, CLOCK) as journal:
        journal.append(event, **data)
    with pytest.raises(JournalBroken, match=r"Line 2 of the ledger"):
        ledger.runs()
