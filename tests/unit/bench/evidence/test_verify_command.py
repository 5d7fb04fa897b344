"""What the command verify says about a run, and its exit status."""

import json
import os
import shutil
from unittest import mock

import pytest
from click.testing import CliRunner

from bench.base.home import HOME_VARIABLE
from bench.commands.cli import cli
from bench.evidence.keys import create_key
from tests.unit.bench.evidence.attack_steps import by_another_program, edit

pytestmark = pytest.mark.usefixtures("made_once")


def told_by_command(folder, home, *words):
    with mock.patch.dict(os.environ, {HOME_VARIABLE: str(home)}):
        return CliRunner().invoke(cli, ["verify", str(folder), *words], standalone_mode=False)


def test_the_command_says_first_what_the_folder_is_worth(run_once, bench_home):
    said = told_by_command(run_once, bench_home)
    assert said.return_value == 0, said.output
    assert said.stdout.startswith("SEALED: ")
    assert "The numbers were not compared with the recordings" in said.stdout.splitlines()[0]
    assert "by the bench's own clock" in said.stdout.splitlines()[1]
    assert "SIMULATED" in said.stdout


def test_the_command_lists_every_fault_and_ends_with_1(forger, bench_home):
    edit("results.json", '"operator": "Ada"', '"operator": "Eve"')(forger)
    forger.seal()
    said = told_by_command(forger.folder, bench_home)
    assert said.return_value == 1
    assert said.stderr.startswith("NOT VERIFIED:")
    assert "results.json: run.operator is" not in said.stderr  # the journal's hash comes first
    assert "results.json: by the journal, it is another file than the one that was written" in said.stderr


def test_the_command_ends_with_4_if_a_part_was_not_compared(forger, bench_home, tmp_path):
    by_another_program(forger, report_form="0" * 16)
    forger.replace("report.html", "Calibration report", "Report of a calibration")
    forger.tell_of_files()
    forger.seal()
    signers = str(bench_home / "allowed_signers")
    said = told_by_command(forger.folder, bench_home, "--json", "--again")
    assert said.return_value == 1  # the ledger of the bench holds the hash of the first seal
    assert {fault["kind"] for fault in json.loads(said.stdout)["faults"]} == {"ledger"}
    said = told_by_command(forger.folder, tmp_path / "elsewhere", "--allowed-signers", signers, "--json")
    assert said.return_value == 0  # nothing was to be compared
    assert json.loads(said.stdout)["again"] is False
    said = told_by_command(
        forger.folder, tmp_path / "elsewhere", "--allowed-signers", signers, "--json", "--again"
    )
    assert said.return_value == 4
    found = json.loads(said.stdout)
    assert (found["ok"], found["complete"]) == (True, False)
    assert found["not_compared"][0].startswith("report.html with results.json: it was made with report form")


def test_a_ledger_that_was_set_back_is_found_with_the_run(run_once, bench_home, tmp_path):
    home = tmp_path / "home"
    shutil.copytree(bench_home, home)
    (home / "ledger.jsonl").write_bytes(b"")
    said = told_by_command(run_once, home)
    assert said.return_value == 1
    assert "its ledger does not contain it" in said.stderr


def test_another_bench_has_no_ledger_for_the_run_and_that_is_no_fault(run_once, bench_home, tmp_path):
    create_key(tmp_path / "elsewhere", principal="other@lab.example")
    signers = str(bench_home / "allowed_signers")
    said = told_by_command(run_once, tmp_path / "elsewhere", "--allowed-signers", signers)
    assert said.return_value == 0, said.output
    assert "no ledger confirms its number" in said.stdout


def test_again_says_first_that_the_numbers_were_compared(run_once, bench_home):
    said = told_by_command(run_once, bench_home, "--again")
    assert said.return_value == 0, said.output
    assert "The results were made again from the recordings and compared." in said.stdout.splitlines()[0]
