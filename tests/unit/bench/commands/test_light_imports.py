"""Commands that only read, and faults in the arguments, load no mathematics and no plots."""

import os
import subprocess
import sys

import pytest

from bench.records.events import Event
from tests.unit.bench.run.test_status import Run

PLOTS_AND_ENGINE = {"matplotlib", "cv2", "numba"}
CODE = """
import sys
from bench.commands.cli import main
try:
    main(sys.argv[2:])
except SystemExit as end:
    print("exit", end.code, file=sys.stderr)
loaded = set(sys.argv[1].split(",")) & set(sys.modules)
print("loaded", sorted(loaded), file=sys.stderr)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from bench.plan.plan import load_documents, make_plan

    path = tmp_path_factory.mktemp("runs") / "run"
    run = Run(path, make_plan(*load_documents("three_pose", "simulated")).to_dict())
    run.tell(Event.ENTERING, state="recording", pose=1)
    run.die()
    return path


@pytest.mark.parametrize(
    ("words", "status", "unwanted"),
    [
        (["status", "{run}"], 0, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
        (["status", "{run}/none"], 2, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
        (["runs", "{run}"], 0, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
        (["statuss"], 2, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
        (["plan", "three_pos", "-s", "simulated"], 2, PLOTS_AND_ENGINE),
        (["plan", "three_pose", "-s", "simulated"], 0, PLOTS_AND_ENGINE | {"scipy"}),
        (["plan", "until_good", "-s", "simulated"], 0, PLOTS_AND_ENGINE | {"scipy"}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_small_commands_load_little(folder, tmp_path, words, status, unwanted):
    environment = {**os.environ, "STARBENCH_HOME": str(tmp_path)}
    words = [word.format(run=folder) for word in words]
    done = subprocess.run(
        [sys.executable, "-c", CODE, ",".join(unwanted), *words],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert f"exit {status}\n" in done.stderr, done.stderr
    assert done.stderr.endswith("loaded []\n")
