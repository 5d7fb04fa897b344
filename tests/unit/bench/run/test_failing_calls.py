"""The n-th call of libc fails or kills: each command that writes ends in words, loses nothing, and works when given again."""

from pathlib import Path

import pytest
from failing_calls import assert_each_call_may_fail, try_in_process
from failing_works import COMMANDS, GOING_ON, OTHERS

PROGRAM = Path(__file__).parents[3] / "support" / "failing_works.py"
SOME = {"target": (6, 15), "ledger": (5, 87), "keys": (2, 27)}
"""First call and step of the works that are tried here; each call of every work is slow."""


def test_whichever_of_some_calls_fails_or_kills_the_same_command_works_again(tmp_path):
    count, ended = try_in_process(PROGRAM, tmp_path, SOME)
    assert (ended.returncode, count >= 10) == (0, True), ended.stdout + ended.stderr


@pytest.mark.slow
@pytest.mark.timeout(3 * 3600)
@pytest.mark.parametrize("name", [*COMMANDS, *GOING_ON, *OTHERS])
def test_whichever_call_fails_or_kills_the_same_command_works_again(tmp_path, name):
    assert_each_call_may_fail(PROGRAM, tmp_path, name)
