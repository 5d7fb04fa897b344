"""The n-th call of libc fails or kills: each command that writes ends in words, loses nothing, and works when given again."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from failing_calls import COMMANDS, build_library

OTHERS = ["certificate", "authorisation", "ledger", "keys", "run"]
SOME = {
    "convert hdf5": (9, 17),
    "certificate new": (2, 5),
    "target": (6, 5),
    "ledger": (5, 29),
    "keys": (4, 17),
}
"""First call and step of the works that are tried here; each call of every work is slow."""
SUPPORT = Path(__file__).parents[3] / "support"


def try_works(folder, steps):
    """Let calls of works fail in a process of its own that has the library; return how many did, and what it said."""
    library = build_library(folder)
    if library is None:
        pytest.skip("needs Linux and a C compiler")
    here = os.pathsep.join([str(SUPPORT), *sys.path])
    ended = subprocess.run(
        [sys.executable, SUPPORT / "failing_works.py", folder, json.dumps(steps)],
        env={**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": here},
        capture_output=True,
        text=True,
        check=False,
    )
    counts = re.findall(r"(\d+) calls failed or killed", ended.stdout)
    return sum(map(int, counts)), ended


def test_whichever_of_some_calls_fails_or_kills_the_same_command_works_again(tmp_path):
    count, ended = try_works(tmp_path, SOME)
    assert (ended.returncode, count >= 30) == (0, True), ended.stdout + ended.stderr


@pytest.mark.slow
@pytest.mark.timeout(3 * 3600)
@pytest.mark.parametrize("name", [*COMMANDS, *OTHERS])
def test_whichever_call_fails_or_kills_the_same_command_works_again(tmp_path, name):
    step = int(os.environ.get("FAILING_CALLS_STEP", "1"))
    count, ended = try_works(tmp_path, {name: (1, step)})
    print(ended.stdout)
    assert (ended.returncode, count * step >= 20) == (0, True), ended.stdout + ended.stderr


if __name__ == "__main__":
    sys.exit(pytest.main([__file__, "-s", "-n", "0", "-m", "slow", *sys.argv[1:]]))
