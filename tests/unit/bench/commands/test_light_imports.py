"""What a shell meets: commands that load little, and completion."""

import pytest
from click.shell_completion import get_completion_class
from running import python
from slow_cases import first_quick

from bench.commands.cli import cli
from bench.record.events import Event
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
    run = Run(tmp_path_factory.mktemp("runs") / "run")
    run.tell(Event.ENTERING, state="recording", pose=1)
    run.die()
    return run.path


@pytest.mark.parametrize(
    ("words", "status", "unwanted"),
    first_quick(
        [
            (["status", "{run}"], 0, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
            (["status", "{run}/none"], 2, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
            (["runs", "{run}"], 0, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
            (["statuss"], 2, PLOTS_AND_ENGINE | {"numpy", "scipy"}),
            (["plan", "three_pos", "-s", "simulated"], 2, PLOTS_AND_ENGINE),
            (["plan", "three_pose", "-s", "simulated"], 0, PLOTS_AND_ENGINE | {"scipy", "cryptography"}),
            (["plan", "until_good", "-s", "simulated"], 0, PLOTS_AND_ENGINE | {"scipy", "cryptography"}),
        ],
        2,
    ),
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_small_commands_load_little(folder, tmp_path, words, status, unwanted):
    words = [word.format(run=folder) for word in words]
    done = python("-c", CODE, ",".join(unwanted), *words, STARBENCH_HOME=tmp_path)
    assert f"exit {status}\n" in done.stderr, done.stderr
    assert done.stderr.endswith("loaded []\n")


# ---------------------------------------------------------------- completion


def proposed(*words: str) -> list[str]:
    completion = get_completion_class("bash")(cli, {}, "starbench", "_STARBENCH_COMPLETE")
    *before, last = words
    return [(item.type, item.value) for item in completion.get_completions(list(before), last)]


def test_stations_and_sequences_are_proposed_and_the_shell_completes_paths():
    assert proposed("ta") == [("plain", "target")]
    assert proposed("run", "thr") == [("plain", "three_pose")]
    assert proposed("run", "--station", "example_n") == [("plain", "example_network")]
    assert proposed("station", "new", "x.yaml", "--light", "g") == [("plain", "gardasoft")]
    assert proposed("run", "my_se") == [("file", "my_se")]
    assert proposed("target", "-o", "x") == [("file", "x")]
    assert proposed("resume", "runs/") == [("dir", "runs/")]
