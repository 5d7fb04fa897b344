"""Hostile inputs at every command that reads a file: one message, status 1 or 2, little memory and time, no harm."""

import json
import os
from pathlib import Path

import pytest
from running import python
from solved_run import write_solved_run

SUPPORT = Path(__file__).parents[1] / "support"
LEAST_CASES = 300


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A solved run, shared by all cases, which only copy it."""
    return write_solved_run(tmp_path_factory.mktemp("run"))


def results_of(folder, run, *options):
    """Do the cases; return what came of each."""
    path = os.pathsep.join([str(SUPPORT), str(SUPPORT.parents[1])])
    ended = python(SUPPORT / "hostile_inputs.py", folder, run, *options, PYTHONPATH=path)
    return [json.loads(line) for line in ended.stdout.splitlines()]


def wrong_cases(results):
    wrong = [each for each in results if each["wrong"]]
    return "\n".join(f"{each['name']}: {each['wrong']} {each['said'][-300:]}" for each in wrong)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_representative_part_of_the_hostile_inputs(tmp_path, run):
    results = results_of(tmp_path / "cases", run, "--few")
    assert len(results) >= 30
    assert not wrong_cases(results), wrong_cases(results)
    assert [each["status"] for each in results if each["name"].startswith("control:")] == [0, 0]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_every_hostile_input(tmp_path, run):
    from hostile_cases import all_cases

    results = results_of(tmp_path / "cases", run)
    assert len({each["name"] for each in results}) == len(results) == len(all_cases(run)) >= LEAST_CASES
    assert not wrong_cases(results), wrong_cases(results)
