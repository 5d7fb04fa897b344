"""The page for contributors: its commands work, and every file that it names exists."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\.venv/bin/pytest (.+)$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("words", COMMANDS)
def test_each_command_runs_tests_that_pass(words):
    command = f"{sys.executable} -m pytest -p no:cacheprovider {words}"
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout


def test_the_first_command_brings_what_the_second_needs():
    """It made the environment without pytest once."""
    target, second = re.findall(r"(?m)^(?:make ([a-z-]+).*|\.venv/bin/(.+))$", TEXT)[:2]
    assert second[1].startswith("pytest ")
    assert f"\n{target[0]}: $(VENV)/installed-dev" in MAKEFILE


def test_each_target_of_make_exists():
    targets = set(re.findall(r"\bmake ([a-z-]+)", TEXT))
    assert len(targets) > 2
    assert {
        name for name in targets if not re.search(rf"(?m)^(?:[a-z-]+ )*{name}(?: [a-z-]+)*:", MAKEFILE)
    } == set()
