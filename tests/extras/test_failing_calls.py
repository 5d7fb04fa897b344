"""The n-th call of libc fails or kills: each command of the extras that writes ends in words, and works when given again."""

from pathlib import Path

import pytest
from failing_calls import assert_each_call_may_fail
from failing_works_of_extras import COMMANDS, GOING_ON, OTHERS

PROGRAM = Path(__file__).parent / "support" / "failing_works_of_extras.py"


@pytest.mark.slow
@pytest.mark.timeout(3 * 3600)
@pytest.mark.parametrize("name", [*COMMANDS, *GOING_ON, *OTHERS])
def test_whichever_call_fails_or_kills_the_same_command_works_again(tmp_path, name):
    assert_each_call_may_fail(PROGRAM, tmp_path, name)
