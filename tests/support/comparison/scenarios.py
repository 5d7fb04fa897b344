"""What both sides do. A scenario gets a side in an empty folder, writes its inputs there and gives its commands.

All that it leaves in the folder is compared: files of runs, the bench's own folder, and what each command said.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from comparison.inputs import BAD_FILES, NIGHT, QUEUE, SHORT_COMMANDS, WARM, replaced, sequence, station
from comparison.sides import Side

SEED = 7


@dataclass(frozen=True)
class Scenario:
    """`play` gets the side, and the old checkout, from which the inputs of both sides come."""

    name: str
    play: Callable[[Side, Path], None]


def _run(shipped: str, at: str = "simulated") -> Callable[[Side, Path], None]:
    """A shipped sequence on the small bench; what the commands afterwards say of the finished run, too."""

    def play(side: Side, old: Path) -> None:
        side.write("sequence.yaml", sequence(old, shipped))
        side.write("station.yaml", station(old, at))
        side.say("run", "sequence.yaml", "-s", "station.yaml", "--seed", SEED, "-o", "run", "--json")
        side.say("verify", "run", "--json")

    return play


def _shipped(side: Side, _old: Path) -> None:
    """The first command of the README, with the sensor in its full size and the files of the checkout itself."""
    side.say("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", "run")
    for words in ("status run --json", "runs --json", "ledger --json", "verify run"):
        side.say(*words.split())


def _batch(side: Side, old: Path) -> None:
    side.write("three.yaml", sequence(old, "three_pose"))
    side.write("station.yaml", station(old))
    side.write("broken.yaml", station(old, "simulated", ("serial: 100102", "serial: 999999")))
    side.write("queue.yaml", QUEUE)
    side.say("batch", "queue.yaml", "-o", "night", "--json")
    side.say("status", "night", "--json")


def _rehearsal(side: Side, old: Path) -> None:
    """A night on a virtual clock; its journals are the same to the last byte."""
    shipped = (old / "bench/stations/simulated.yaml").read_text(encoding="utf-8")
    side.write("warm.yaml", replaced(shipped, WARM))
    side.write("queue.yaml", NIGHT)
    side.say("rehearse", "queue.yaml", "-o", "night", "--begin", "2026-03-01T19:30", "--json")
    side.say("runs", "night", "--json")


def _resumed(side: Side, old: Path) -> None:
    side.write("sequence.yaml", sequence(old, "three_pose"))
    side.write("station.yaml", station(old))
    words = ("run", "sequence.yaml", "-s", "station.yaml", "--seed", SEED, "-o", "run")

    def second_pose(entry: dict) -> bool:
        return entry["event"] == "entering" and entry["state"] == "recording" and entry.get("pose") == 2

    side.kill_at(second_pose, "run", *words)
    for capture in (side.folder / "run" / "captures").glob("pose-00[23]*"):
        capture.unlink()
    side.say("resume", "run", "--dry-run")
    side.say("resume", "run", "--json")


def _recalculated(side: Side, old: Path) -> None:
    """From the run's recordings: with its own options, with others, many at once, in other formats."""
    side.write("sequence.yaml", sequence(old, "nine_pose"))
    side.write("station.yaml", station(old))
    side.say("run", "sequence.yaml", "-s", "station.yaml", "--seed", SEED, "-o", "run")
    side.say("calibrate", "run", "--json")
    captures = sorted(
        path.relative_to(side.folder).as_posix() for path in (side.folder / "run/captures").iterdir()
    )
    for model in ("spherical", "radial", "pupil"):
        side.say(
            "calibrate", "run", "--model", model, "--distortion", "auto", "--views", "1,3,5,7,8,9", "--json"
        )
    side.say("calibrate", *captures, "--model", "joint", "--json")
    side.say("passport", "make", "run", "-o", "passport.json", "--json")
    side.say("calibrate", "run", "--views", "2,5", "--passport", "passport.json", "--json")
    side.say("calibrate", "--each", "run", "-o", "again", "--workers", "1", "--json")
    side.say("verify", "run", "--again", "--json")
    for name in ("pose.hdf5", "pose.h5", "pose.npz"):
        side.say("convert", captures[0], name)


def _certificate(side: Side, old: Path) -> None:
    side.write("sequence.yaml", sequence(old, "three_pose"))
    side.write("station.yaml", station(old))
    side.say("run", "sequence.yaml", "-s", "station.yaml", "--seed", SEED, "-o", "run")
    sample: dict[str, str] = {}
    text = next(old.glob("tests/**/certificate_sample.py")).read_text(encoding="utf-8")
    begin, end = text.index('KEY = "'), text.index('"""A lab.yaml with everything')
    exec(text[begin:end], sample)  # the sample's own lines, without the imports of its program
    changes = (("2026-11-18", "2020-01-07"), ("2025-11-20", "2020-01-07"), ("2026-01-08", "2020-01-07"))
    side.write("lab.yaml", replaced(sample["LAB"], *changes))
    side.say("certificate", "issue", "run", "-c", "lab.yaml", "-o", "first", "--json")
    side.write("corrected.yaml", replaced(sample["LAB"], *changes, ("Mill Lane 3", "Mill Lane 4")))
    corrected = ("-c", "corrected.yaml", "-o", "second", "--reason", "A wrong address.")
    side.say("certificate", "issue", "first", *corrected)
    for words in ("show first", "show --json"):
        side.say("certificate", *words.split())
    side.say("verify", "second", "--json")


def _bad_inputs(side: Side, old: Path) -> None:
    good = {
        "sequence": (old / "sequences/three_pose.yaml").read_text(encoding="utf-8"),
        "station": (old / "bench/stations/simulated.yaml").read_text(encoding="utf-8"),
    }
    commands = {}
    for name, changes in BAD_FILES.items():
        for kind, change in zip(good, changes, strict=True):
            side.write(f"{name}-{kind}.yaml", replaced(good[kind], *([change] if change else [])))
        words = [f"{name}-sequence.yaml", "-s", f"{name}-station.yaml", "--seed", "1", "-o", f"out-{name}"]
        commands[name] = ["run", *words]
        commands[f"{name}-plan"] = ["plan", *words[:3], "--json"]
    side.say_many(commands)


def _short_commands(side: Side, old: Path) -> None:
    side.write("three.yaml", sequence(old, "three_pose"))
    side.write("station.yaml", station(old))
    shutil.copy(side.folder / "station.yaml", side.folder / "broken.yaml")
    side.write("queue.yaml", QUEUE)
    side.say_many({name: words.split() for name, words in SHORT_COMMANDS.items()})


SCENARIOS = [
    Scenario("short_commands", _short_commands),
    Scenario("bad_inputs", _bad_inputs),
    Scenario("rehearsal", _rehearsal),
    Scenario("three_pose", _shipped),
    Scenario("nine_pose", _run("nine_pose")),
    Scenario("turntable", _run("turntable")),
    Scenario("frames", _run("three_pose", "simulated_frames")),
    Scenario("batch", _batch),
    Scenario("resumed", _resumed),
    Scenario("recalculated", _recalculated),
    Scenario("certificate", _certificate),
]
