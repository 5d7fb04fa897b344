"""The core without `bench/extras`: it works, and what needs an extra says which."""

import shutil
from pathlib import Path

import pytest
from quick_runs import write_queue
from running import start_python
from slow_cases import first_quick
from waiting import wait_until

ROOT = Path(__file__).parents[3]
PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")


class Core:
    """A copy of the program whose extras were deleted."""

    def __init__(self, folder):
        self.folder = folder
        for name in PACKAGES:
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("extras"))
        (folder / "work").mkdir()
        (folder / "home").mkdir()
        (folder / "home" / "allowed_signers").touch()

    def start(self, *words):
        places = {"PYTHONPATH": self.folder, "STARBENCH_HOME": self.folder / "home"}
        return start_python("-m", "bench", *words, cwd=self.folder / "work", **places)

    def __call__(self, *words, status=0):
        process = self.start(*words)
        out, err = process.communicate(timeout=600)
        assert process.returncode == status, err
        return out + err


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    return Core(tmp_path_factory.mktemp("core"))


def test_the_core_lists_plans_and_draws(core):
    assert "resume" in core("--help")
    assert "Three poses" in core("plan", "three_pose", "-s", "simulated")
    core("target", "-s", "simulated", "-o", "target.svg")


@pytest.mark.parametrize(
    ("words", "extra"),
    first_quick(
        [
            (["history", "charts"], "bench.extras.history"),
            (["certificate", "new", "lab.yaml"], "bench.extras.certificate"),
            (["schema", "lab"], "bench.extras.certificate"),
            (["verify", "."], "bench.extras.certificate"),
            (["calibrate", ".", "--each", "--workers", "2"], "bench.extras.many"),
        ],
        3,
    ),
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_what_needs_an_extra_says_which(core, words, extra):
    (core.folder / "work" / "certificate.json").write_text("{}")
    assert extra in core(*words, status=2)


@pytest.mark.slow
@pytest.mark.timeout(1500)  # the copy compiles its loops
def test_the_core_runs_verifies_and_calibrates(core):
    core("station", "new", "bench.yaml", "--stand-ins", "keysight")
    core("keys", "show")
    core("run", "three_pose", "-s", "simulated", "--seed", "1", "-o", "runs/one")
    assert "sealed" in core("resume", "runs/one", status=1)
    assert "finished" in core("status", "runs/one")
    core("verify", "runs/one")
    core("verify", "runs/one", "--again")
    interrupted = core.start("run", "three_pose", "-s", "simulated", "--seed", "1", "-o", "runs/two")
    journal_path = core.folder / "work" / "runs" / "two" / "journal.jsonl"
    wait_until(lambda: journal_path.exists() and "capture_stored" in journal_path.read_text(), 300)
    interrupted.kill()
    interrupted.communicate()
    core("resume", "runs/two")
    core("verify", "runs/two")
    core("calibrate", "runs/one")
    core("calibrate", "runs/one", "--each", "-o", "each")
    write_queue(core.folder / "work" / "queue.yaml", "name: one, sequence: three_pose, station: simulated")
    core("batch", "queue.yaml", "-o", "night")
