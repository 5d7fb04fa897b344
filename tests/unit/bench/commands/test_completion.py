"""Completion in the shell: what each shell gets, and that bash uses it."""

import shutil
import subprocess
import sys

import pytest
from click.shell_completion import get_completion_class

from bench.commands.cli import cli


def proposed(shell: str, *words: str) -> list[str]:
    completion = get_completion_class(shell)(cli, {}, "starbench", "_STARBENCH_COMPLETE")
    *before, last = words
    return [(item.type, item.value) for item in completion.get_completions(list(before), last)]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_commands_options_stations_and_sequences_are_proposed(shell):
    assert proposed(shell, "ta") == [("plain", "target")]
    assert ("plain", "show") in proposed(shell, "keys", "")
    assert ("plain", "--station") in proposed(shell, "run", "--st")
    assert proposed(shell, "run", "thr") == [("plain", "three_pose")]
    assert [name for _, name in proposed(shell, "align", "--station", "example_")] == [
        "example_dynamixel",
        "example_evk4",
        "example_network",
        "example_thorlabs",
        "example_turntable",
    ]
    assert proposed(shell, "station", "new", "x.yaml", "--light", "g") == [("plain", "gardasoft")]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_paths(shell):
    assert proposed(shell, "run", "my_se") == [("file", "my_se")]
    assert proposed(shell, "resume", "runs/") == [("dir", "runs/")]
    assert proposed(shell, "target", "-o", "x") == [("file", "x")]


def test_bash_takes_the_script_and_completes_with_it(tmp_path):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("bash is not installed")
    program = tmp_path / "starbench"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m bench "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    script = """
eval "$(_STARBENCH_COMPLETE=bash_source starbench)"
COMP_WORDS=(starbench keys ro); COMP_CWORD=2
_starbench_completion starbench
echo "${COMPREPLY[@]}"
"""
    done = subprocess.run(
        [bash, "--norc", "-c", script],
        env={"PATH": f"{tmp_path}:/usr/bin:/bin", "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.strip() == "rotate"
