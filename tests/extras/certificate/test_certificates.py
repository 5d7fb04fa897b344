"""A certificate from a real run on the simulated bench, by the command line."""

import json
import subprocess

import pytest
from certificate_sample import LAB
from running import starbench


@pytest.mark.slow
def test_a_certificate_of_a_run_verifies_with_starbench_and_with_stock_programs(tmp_path):
    def done(*words):
        ended = starbench(*words, home=tmp_path / "home")
        return ended.stdout

    text = LAB
    for date in ("2026-11-18", "2025-11-20", "2026-01-08"):
        text = text.replace(date, "2020-01-07")  # before the run
    (tmp_path / "lab.yaml").write_text(text, encoding="utf-8")
    run, folder = tmp_path / "run", tmp_path / "first"
    done("run", "three_pose", "-s", "simulated", "-o", run)
    words = ("issue", run, "-c", tmp_path / "lab.yaml", "-o", folder, "--json")
    issued = json.loads(done("certificate", *words))
    assert issued["certificate"]["run"]["id"] == "run"
    assert json.loads(done("verify", folder, "--json"))["state"] == "SEALED"
    subprocess.run(["sha256sum", "--strict", "--quiet", "-c", "SHA256SUMS"], cwd=folder, check=True)
