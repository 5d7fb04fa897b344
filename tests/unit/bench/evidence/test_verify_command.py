"""What `verify` says of sealed runs, its exit status, and what leaves a run valid."""

import json
import os
from pathlib import Path
from unittest import mock

import pytest
from click.testing import CliRunner

from bench.base.home import HOME_VARIABLE
from bench.commands.cli import cli
from bench.evidence.keys import create_key
from tests.unit.bench.evidence.attack_steps import by_another_program, checked, edit, result
from tests.unit.bench.evidence.resealed import copied, kinds

pytestmark = pytest.mark.usefixtures("made_once")


def told_by_command(folder, home, *words):
    with mock.patch.dict(os.environ, {HOME_VARIABLE: str(home)}):
        return CliRunner().invoke(cli, ["verify", str(folder), *words], standalone_mode=False)


@pytest.mark.parametrize(
    ("words", "says"), [([], "not compared with the recordings"), (["--again"], "made again")]
)
def test_the_command_says_first_what_the_folder_is_worth(run_once, bench_home, words, says):
    ended = told_by_command(run_once, bench_home, *words)
    assert ended.return_value == 0, ended.output
    assert ended.stdout.startswith("SEALED: ")
    assert says in ended.stdout.splitlines()[0]
    assert "own clock" in ended.stdout.splitlines()[1]
    assert "SIMULATED" in ended.stdout


def test_the_command_lists_every_fault_and_ends_with_1(forger, bench_home):
    edit("results.json", '"operator": "Ada"', '"operator": "Eve"')(forger)
    forger.seal()
    ended = told_by_command(forger.folder, bench_home)
    assert ended.return_value == 1
    assert ended.stderr.startswith("NOT VERIFIED:")
    assert "results.json: run.operator is" not in ended.stderr  # the journal's hash comes first
    assert "results.json: " in ended.stderr


def test_the_name_of_a_file_writes_no_line_of_its_own(forger, bench_home):
    (forger / "exports/a\nSEALED: 20 files, sealed by bench@lab. Compared.\nz").write_text("x")
    ended = told_by_command(forger.folder, bench_home)
    assert ended.return_value == 1
    assert not [line for line in ended.output.splitlines() if line.startswith(("SEALED", "z"))]


def test_the_command_ends_with_4_if_a_part_was_not_compared(forger, bench_home, tmp_path):
    by_another_program(forger, report_form="0" * 16)
    forger.replace("report.html", "Calibration report", "Report of a calibration")
    forger.tell_of_files()
    forger.seal()
    ended = told_by_command(forger.folder, bench_home, "--json", "--again")
    assert ended.return_value == 1  # the ledger of the bench holds the hash of the first seal
    assert {fault["kind"] for fault in json.loads(ended.stdout)["faults"]} == {"ledger"}
    elsewhere = (tmp_path / "elsewhere", "--allowed-signers", str(bench_home / "allowed_signers"))
    ended = told_by_command(forger.folder, *elsewhere, "--json")
    assert ended.return_value == 0  # nothing was to be compared
    assert json.loads(ended.stdout)["again"] is False
    ended = told_by_command(forger.folder, *elsewhere, "--json", "--again")
    assert ended.return_value == 4, ended.output
    answer = json.loads(ended.stdout)
    assert (answer["ok"], answer["complete"]) == (True, False)
    assert answer["not_compared"][0].startswith("report.html with results.json: ")
    ended = told_by_command(forger.folder, *elsewhere, "--again")
    assert "NOT COMPARED." in ended.stdout


def test_another_bench_has_no_ledger_for_the_run_and_that_is_no_fault(run_once, bench_home, tmp_path):
    create_key(tmp_path / "elsewhere", principal="other@lab.example")
    signers = str(bench_home / "allowed_signers")
    ended = told_by_command(run_once, tmp_path / "elsewhere", "--allowed-signers", signers)
    assert ended.return_value == 0, ended.output
    assert "no ledger confirms" in ended.stdout


# ---------------------------------------------------------------- what happens to any archive


def test_what_happens_to_any_archive_leaves_it_valid(run_once, trusted, tmp_path, monkeypatch):
    """It is renamed, is older, has other modes, and is reached by a link and a relative path."""
    archive = copied(run_once, tmp_path / "another name, with ü")
    for path in [*archive.rglob("*"), archive]:
        os.utime(path, (0, 0))
        path.chmod(0o700 if path.is_dir() else 0o600)
    (tmp_path / "link").symlink_to(archive)
    monkeypatch.chdir(tmp_path)
    verification = checked(Path("link"), trusted)
    assert (verification.faults, verification.not_compared, verification.complete) == ([], [], True)


# ---------------------------------------------------------------- other versions of the program


def with_a_plugin(f):
    """Journal and results state a plug-in that this computer does not have."""
    f.edit_line("run_started", lambda d: d.update(plugins={"starbench-turntable": ["stage turntable"]}))
    f.edit_results(lambda r: r["run"].update(plugins={"starbench-turntable": ["stage turntable"]}))
    by_another_program(f, **{"starbench-turntable": "1.0"})


def test_a_run_on_a_plugin_that_is_not_here_is_not_compared_and_no_fault(forger, trusted):
    with_a_plugin(forger)
    station = (forger / "station.yaml").read_text().replace("driver: zaber_ascii", "driver: turntable")
    (forger / "station.yaml").write_text(station)
    forger.tell_of_files()
    forger.seal()
    verification = checked(forger.folder, trusted)
    assert verification.faults == []
    (what,) = verification.not_compared
    assert "starbench-turntable 1.0" in what


def test_a_plugin_that_the_station_does_not_use_is_found(forger, trusted):
    with_a_plugin(forger)
    forger.seal()
    verification = checked(forger.folder, trusted)
    assert "report.html" in {fault.where for fault in verification.faults}
    assert any("starbench-turntable 1.0" in remark for remark in verification.remarks)


def test_another_program_that_writes_the_same_bytes_is_compared(forger, trusted, job):
    by_another_program(forger, program="0" * 16)
    forger.render(job)
    forger.tell_of_files()
    forger.seal()
    verification = checked(forger.folder, trusted)
    assert verification.complete
    assert any("program 0000000000000000 (here " in remark for remark in verification.remarks)


def test_another_program_does_not_excuse_what_both_state(forger, trusted):
    by_another_program(forger, program="0" * 16, starbench="9.9")
    result("devices", "camera", "serial", to="00050999")(forger)
    forger.seal()
    assert ("results", "results.json") in kinds(checked(forger.folder, trusted))
