"""The commands that issue, amend, list and show certificates: what they print, and their exit statuses."""

import json
import re
from datetime import UTC, datetime
from unittest import mock

import pytest
from certificate_lab import FIRST, quick_files
from certificate_sample import LAB, verified
from click.testing import CliRunner
from sealed_bench import write_sealed_run

from bench.base.clock import VirtualClock
from bench.base.errors import BenchError, UsageError
from bench.commands.cli import cli
from bench.extras.certificate import issue as issue_module
from bench.extras.certificate.commands import certificate
from bench.extras.certificate.lab_config import LabConfig
from bench.record.ledger import Ledger
from sequences.errors import DocumentFaults

SECOND = "SIMULATED-SB-2026-00002"
LATER = datetime(2026, 12, 1, tzinfo=UTC)


class LaterClock(datetime):
    """A clock of the year of the sample."""

    @classmethod
    def now(cls, tz=None):
        return LATER.astimezone(tz)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A bench with a sealed run and a lab.yaml; PDF, DCC and the verification of the run are left out."""
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    write_sealed_run(tmp_path / "run", tmp_path / "home")
    (tmp_path / "lab.yaml").write_text(LAB, encoding="utf-8")
    ledger = Ledger(tmp_path / "home", VirtualClock(LATER))
    with (
        mock.patch.object(issue_module, "certificate_files", quick_files),
        mock.patch.object(certificate, "verify_sealed", verified),
        mock.patch.object(certificate, "datetime", LaterClock),
        mock.patch.object(certificate, "bench_ledger", return_value=ledger),
        mock.patch("bench.extras.certificate.pdf.plots_of_run", return_value={}),
    ):
        yield tmp_path


def run(*arguments):
    done = CliRunner().invoke(cli, ["certificate", *arguments], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    assert not done.return_value
    return done.output


def test_a_certificate_is_issued_listed_and_shown(bench):
    output = run("issue", "run", "-c", "lab.yaml", "-o", "first")
    assert re.match(rf"SIMULATED .* {FIRST}\nState:      SEALED\n", output)
    assert "  fx   3346.0 px \N{PLUS-MINUS SIGN} 2.0 px  (k = 2.02)" in output
    assert "starbench certificate authorise" in output
    heads, row = run("show").splitlines()
    assert heads.split() == ["number", "state", "camera", "customer", "date"]
    assert row.split("  ") == [FIRST, "SEALED", "00050423", "Customer & Sons <GmbH>", "2026-12-01"]
    assert run("show", "first").splitlines()[1] == "State:      SEALED"
    assert json.loads(run("show", "first", "--json"))["certificate"]["number"] == FIRST


def test_json_is_one_object(bench):
    issued = json.loads(run("issue", "run", "-c", "lab.yaml", "-o", "first", "--json"))
    assert (issued["number"], issued["state"], issued["completed"]) == (FIRST, "SEALED", [])
    (row,) = json.loads(run("show", "--json"))["certificates"]
    assert (row["number"], row["state"], row["folder"]) == (FIRST, "SEALED", str(bench / "first"))


def test_an_amended_certificate_is_shown_as_superseded(bench):
    run("issue", "run", "-c", "lab.yaml", "-o", "first")
    (bench / "lab.yaml").write_text(LAB.replace("Mill Lane 3", "Mill Lane 4"), encoding="utf-8")
    output = run("issue", "first", "-c", "lab.yaml", "-o", "second", "--reason", "wrong address")
    assert f"Replaces {FIRST}: wrong address\n" in output
    assert "customer.address.street: 'Mill Lane 3' -> 'Mill Lane 4'" in output
    assert f"SUPERSEDED by {SECOND}" in run("show", "first")
    assert f"replaced by {SECOND}" in run("show")


def issue_that_fails_at(function):
    error = BenchError("killed")
    with mock.patch.object(issue_module, function, side_effect=error), pytest.raises(BenchError):
        run("issue", "run", "-c", "lab.yaml", "-o", "first")


def test_a_number_left_open_is_a_draft_until_it_is_void(bench):
    issue_that_fails_at("write_sealed")
    assert "DRAFT" in run("show")
    with mock.patch("getpass.getuser", side_effect=KeyError("no such user, as in a container")):
        assert run("void", FIRST, "--reason", "disk full") == f"{FIRST} is void: disk full\n"
    assert "VOID" in run("show")
    with pytest.raises(UsageError, match="reason is empty"):
        run("void", FIRST, "--reason", " ")


def test_a_certificate_that_was_complete_cannot_be_void(bench):
    issue_that_fails_at("enter_issued")
    with pytest.raises(BenchError, match=f"{FIRST} is issued"):
        run("void", FIRST, "--reason", "x")
    assert "SEALED" in run("show")


def test_a_certificate_that_was_moved_or_changed_is_not_claimed_to_be_sealed(bench):
    run("issue", "run", "-c", "lab.yaml", "-o", "first")
    (bench / "first").rename(bench / "elsewhere")
    assert "NOT FOUND" in run("show")


def test_the_example_is_written_and_refused_until_it_is_filled_in(bench):
    assert "Replace every REPLACE" in run("new", "mine.yaml")
    with pytest.raises(DocumentFaults) as refused:
        run("issue", "run", "-c", "mine.yaml", "-o", "first")
    assert len(refused.value.faults) > 30
    with pytest.raises(UsageError, match="already exists"):
        run("new", "mine.yaml")
    assert "no certificates" in run("show")


def test_a_folder_without_a_certificate_is_refused(bench):
    with pytest.raises(UsageError, match="holds no certificate"):
        run("show", "run")


def test_the_schema_of_lab_yaml_is_printed():
    done = CliRunner().invoke(cli, ["schema", "lab"], standalone_mode=False)
    assert set(json.loads(done.output)["properties"]) == set(LabConfig.model_fields)
