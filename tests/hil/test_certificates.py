"""A certificate from a real run on the simulated bench, by the command line, and tampered with."""

import json
import subprocess

import pytest
from certificate_sample import LAB
from running import starbench

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with a sealed run, its configuration folder, and lab.yaml with a date of receipt long ago."""
    folder = tmp_path_factory.mktemp("lab")
    said = starbench("run", "three_pose", "-s", "simulated", "-o", folder / "run", home=folder / "home")
    assert said.returncode == 0, said.stderr
    text = (
        LAB.replace("2026-11-18", "2020-01-07")
        .replace("2025-11-20", "2020-01-07")
        .replace("2026-01-08", "2020-01-07")
    )
    (folder / "lab.yaml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def issued(lab):
    said = certificate(lab, "issue", lab / "run", "-c", lab / "lab.yaml", "-o", lab / "first", "--json")
    assert said.returncode == 0, said.stderr
    return json.loads(said.stdout)


def certificate(lab, *words):
    return starbench("certificate", *words, home=lab / "home")


def test_it_verifies_with_starbench_and_with_stock_programs(lab, issued):
    said = starbench("verify", lab / "first", "--json", home=lab / "home")
    assert said.returncode == 0, said.stdout
    assert json.loads(said.stdout)["state"] == "SEALED"
    subprocess.run(["sha256sum", "--strict", "--quiet", "-c", "SHA256SUMS"], cwd=lab / "first", check=True)
    assert issued["certificate"]["run"]["id"] == "run"
