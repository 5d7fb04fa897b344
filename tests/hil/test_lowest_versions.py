"""The lowest versions that pyproject.toml names are installed, and make a run whose numbers are right."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOWEST = re.compile(r"([A-Za-z0-9._-]+)>=([0-9.]+)")


def lowest_versions():
    """Return the requirements of the project, each at its lowest version."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    return ["{}=={}".format(*LOWEST.match(requirement).groups()) for requirement in stated]


def test_every_dependency_has_a_lowest_version():
    assert "numpy" in {requirement.partition("==")[0] for requirement in lowest_versions()}


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_the_lowest_versions_make_a_run(tmp_path):
    venv, run = tmp_path / "venv", tmp_path / "run"
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    pip = [venv / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-compile", "--only-binary=:all:"]
    if subprocess.run([*pip, *lowest_versions()], capture_output=True, check=False).returncode:
        pytest.skip("the lowest versions cannot be had here")
    subprocess.run(
        [venv / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-deps", ROOT], check=True
    )
    environ = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "STARBENCH_HOME": str(tmp_path / "home")}
    starbench = venv / "bin" / "starbench"
    words = [starbench, "run", "three_pose", "-s", "simulated", "--seed", "1", "-o", run]
    ended = subprocess.run(words, env=environ, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    calibration = json.loads((run / "results.json").read_text())["calibration"]
    assert calibration["camera"]["fx"] == pytest.approx(3345.06, abs=3 * calibration["sigma"]["fx"])
    subprocess.run([starbench, "verify", run], env=environ, cwd=tmp_path, check=True)
