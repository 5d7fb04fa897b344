"""The cases of `hostile_inputs`: commands with files, folders and words that are wrong in every way we know."""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from hostile_files import CAMERAS, PASSPORTS, PICTURES, POINTS, RAW, WRONG, YAML
from station_texts import PLAIN

_EXTRAS = {"align", "convert", "certificate", "check", "rig", "undistort"}
"""Commands of `bench.extras`: the names of their cases have the command as a part."""


@dataclass(frozen=True)
class Case:
    """One command on one input.

    ``make`` gets the case's own folder and returns the command's words; ``exits`` are the statuses that are right;
    ``named`` says that a message must name the input.
    """

    name: str
    make: Callable[[Path], list[str]]
    exits: tuple[int, ...] = (1, 2)
    named: bool = True


def _file(words, name, write):
    """A case whose command gets one file; ``{}`` among the words stands for it."""

    def make(folder):
        write(folder / name)
        return [word.replace("{}", name) for word in words]

    return make


def _copy_run(run, to):
    shutil.copytree(run, to, symlinks=True)
    for path in [to, *to.rglob("*")]:
        if not path.is_symlink():
            path.chmod(0o700 if path.is_dir() else 0o600)


_RIG = "rig points.csv second/points.csv --board checkerboard:5x4:10mm --image-size 1280x720 --calibration {} {} -o out"
READERS = {
    "plan-sequence": (("plan", "{}", "--station", "simulated"), "bad.yaml"),
    "run-sequence": (("run", "{}", "--station", "simulated", "--output", "out"), "bad.yaml"),
    "plan-station": (("plan", "three_pose", "--station", "{}"), "bad.yaml"),
    "draw-station": (("target", "--station", "{}", "--output", "out.svg"), "bad.yaml"),
    "simulate-station": (("simulate", "--station", "{}"), "bad.yaml"),
    "align-station": (("align", "--station", "{}", "--no-browser"), "bad.yaml"),
    "batch-queue": (("batch", "{}", "--output", "out"), "bad.yaml"),
    "rehearse-queue": (("rehearse", "{}", "--output", "out"), "bad.yaml"),
    "calibrate-raw": (("calibrate", "{}"), "bad.raw"),
    "calibrate-points": (("calibrate", "{}"), "bad.csv"),
    "calibrate-picture": (("calibrate", "{}"), "bad.png"),
    "calibrate-jpeg": (("calibrate", "{}"), "bad.jpg"),
    "calibrate-tiff": (("calibrate", "{}"), "bad.tiff"),
    "convert": (("convert", "{}", "out.raw"), "bad.h5"),
    "convert-raw": (("convert", "{}", "out.hdf5"), "bad.raw"),
    "passport-show": (("passport", "show", "{}"), "bad.json"),
    "signers": (("verify", "RUN", "--allowed-signers", "{}"), "bad.signers"),
    "certificate-show": (("certificate", "show", "{}"), "bad"),
    "certificate-config": (("certificate", "issue", "RUN", "--config", "{}", "--output", "out"), "bad.yaml"),
    "check": (("check", "points.csv", "--calibration", "{}"), "bad.yaml"),
    "rig": (_RIG.split(), "bad.json"),
    "undistort": (("undistort", "{}", "--output", "out"), "bad.yaml"),
    "undistort-preview": (("undistort", "camera.json", "-o", "out", "--preview", "{}"), "bad.png"),
    "folder-verify": (("verify", "{}"), "bad"),
    "folder-status": (("status", "{}"), "bad"),
}
FEW_WRONG = {"empty", "random", "sparse", "fifo", "device", "link-to-itself", "endless-line"}
_FEW_READERS = ("calibrate-points", "convert", "passport-show")


def wrong_files(run: Path) -> Iterator[Case]:
    """Every command with what can stand in the place of any file."""
    for reader, (words, name) in READERS.items():
        given = [str(run) if word == "RUN" else word for word in words]
        for wrong, write in WRONG.items():
            named = not reader.endswith(("signers", "verify"))
            yield Case(f"{reader}:{wrong}", _file(given, name, write), named=named)


def text(content: str | bytes) -> Callable[[Path], object]:
    """Write this content to a path."""
    return lambda path: path.write_text(content) if isinstance(content, str) else path.write_bytes(content)


def spoilt_files() -> Iterator[Case]:
    """Files of the right kind with something wrong in them."""
    for name, content in YAML.items():
        for reader in ("plan-sequence", "plan-station", "batch-queue"):
            yield Case(f"{reader}:{name}", _file(*READERS[reader], text(content)))
    for name, content in RAW.items():
        yield Case(f"calibrate-raw:{name}", _file(*READERS["calibrate-raw"], text(content)))
        may_work = (0, 1, 2) if name in _CONVERTIBLE else (1, 2)
        yield Case(f"convert-raw:{name}", _file(*READERS["convert-raw"], text(content)), may_work)
    for name, content in PICTURES.items():
        yield Case(f"picture:{name}", _file(("calibrate", "{}"), f"bad-{name}", text(content)))
    for name, content in POINTS.items():
        make = _file(("calibrate", "{}"), "bad.csv", text(content))
        yield Case(f"points:{name}", make, named=name not in _ONE_VIEW)

        def three(folder, content=content):
            (folder / "bad").mkdir()
            for view in "abc":
                (folder / "bad" / f"{view}.csv").write_text(content)
            return ["calibrate", "bad"]

        yield Case(f"three-points:{name}", three, named=False)
    for name, content in PASSPORTS.items():
        yield Case(f"passport:{name}", _file(READERS["passport-show"][0], "bad.json", text(content)))
        words = ("calibrate", "points.csv", "--passport", "{}")
        yield Case(f"with-passport:{name}", _file(words, "bad.json", text(content)), named=True)

    for name, content in CAMERAS.items():
        for reader in ("check", "rig", "undistort"):
            yield Case(f"camera:{reader}:{name}", _file(*READERS[reader], text(content)))
        yield Case(f"camera:step:{name}", partial(_checked_in_a_sequence, content=content))


def _checked_in_a_sequence(folder: Path, content: str | bytes) -> list[str]:
    text(content)(folder / "camera.yaml")
    (folder / "bad.yaml").write_text(
        "format: starbench/sequence/1\nname: Check\nsteps:\n  - light\n  - record\n"
        "  - check: {calibration: camera.yaml}\n  - report\n"
    )
    return ["plan", "bad.yaml", "--station", "simulated"]


_CONVERTIBLE = {
    *("header-only", "odd-byte", "zero-words", "vectors", "clock-storm", "triggers-only", "noise", "ones"),
    "nul-in-header",
}

_ONE_VIEW = {"negative-id", "one-point", "in-a-line", "all-at-once"}
"""Points that can be read: the message says that one view is not enough."""


STATION_VALUES = {
    "spy-url": ("sim:light", "spy:///dev/null?file=../canary/victim.txt"),
    "file-url": ("sim:light", "file:///etc/passwd"),
    "huge-scale": ("microsteps_per_deg: 6400", "microsteps_per_deg: 1e300"),
    "focal-huge": ("focal_px: 3300", "focal_px: 1e308"),
    "radius": ("r_mm: 255, half", "r_mm: 1e-300, half"),
    "image": ("focal_px: 3300", "focal_px: 3300, image_size: [1000000000, 1000000000]"),
    "many-stars": ("simulation: {}", "simulation: {}\ntarget: {squares: [10000, 10000]}"),
    "pitch": ("simulation: {}", "simulation: {}\ntarget: {pitch_mm: 1e-300}"),
    "glass": ("simulation: {}", "simulation: {}\ntarget: {drawing: {size_mm: [1e300, 1e300]}}"),
    "underscore": ("speed_deg_s: 40", "speed_deg_s: 6_0"),
    "sensor": ("simulation: {}", "simulation: {camera: {width: 1000000, height: 1000000}}"),
    "name": ("name: ", 'name: "\\u202e\\u0007\\u001b[2J"  # '),
    "serial": ("serial: 100101", 'serial: "\\u001b[2J"'),
    "limits-crossed": ("simulation: {}", "simulation: {}\nlimits: [{result: fx, lower: 2, upper: 1}]"),
    "limit-nan": ("simulation: {}", "simulation: {}\nlimits: [{result: fx, lower: .nan}]"),
    "many-limits": ("simulation: {}", "simulation: {}\nlimits: [" + "{result: fx, upper: 1}, " * 200 + "]"),
    "standard": ("simulation: {}", "simulation: {}\ncheck_standard: {serial: [5]}"),
    "passport-device": ("nominal_r_mm: 255", "nominal_r_mm: 255, passport: /dev/zero"),
    "passport-fifo": ("nominal_r_mm: 255", "nominal_r_mm: 255, passport: pipe"),
}


def stations() -> Iterator[Case]:
    """A station file with one value that makes no sense."""
    for name, (old, new) in STATION_VALUES.items():
        assert old in PLAIN, old

        def make(folder, old=old, new=new):
            os.mkfifo(folder / "pipe")
            (folder / "bad.yaml").write_text(PLAIN.replace(old, new))
            if new.startswith("simulation: {camera"):
                return ["simulate", "--station", "bad.yaml"]
            return ["plan", "three_pose", "--station", "bad.yaml"]

        yield Case(f"station:{name}", make, named=not new.startswith("simulation: {camera"))


RUN_FILES = (
    "journal.jsonl",
    "results.json",
    "views.h5",
    "plan.json",
    "sequence.yaml",
    "station.yaml",
    "report.html",
)
_CALIBRATED_FROM = ("journal.jsonl", "sequence.yaml", "station.yaml")  # without the others it is a valid run
RUN_COMMANDS = {
    "status": ["status", "bad"],
    "verify": ["verify", "bad"],
    "resume": ["resume", "bad", "--dry-run"],
    "runs": ["runs", "."],
    "calibrate": ["calibrate", "bad"],
    "rig": ["rig", "bad", "bad"],
}
_RUN_WRONG = ("empty", "random", "sparse", "fifo", "folder", "deep-json", "endless-line", "link-to-itself")


def run_folders(run: Path) -> Iterator[Case]:
    """A run folder one of whose files is something else."""
    for wrong in _RUN_WRONG:
        for file in RUN_FILES:
            for command, words in RUN_COMMANDS.items():
                if command in ("calibrate", "rig") and file not in _CALIBRATED_FROM:
                    continue
                if (hash_of(f"{wrong}{file}{command}") % 3) and file != "journal.jsonl":
                    continue  # a third of them: all would be 336

                def make(folder, wrong=wrong, file=file, words=words):
                    _copy_run(run, folder / "bad")
                    (folder / "bad" / file).unlink(missing_ok=True)
                    WRONG[wrong](folder / "bad" / file)
                    return list(words)

                yield Case(f"run-folder:{command}:{file}:{wrong}", make, (0, 1, 2), named=False)


def hash_of(text: str) -> int:
    """A number that is the same in every process."""
    return sum(ord(letter) * (k + 1) for k, letter in enumerate(text))


def odd_folders(run: Path) -> Iterator[Case]:
    """Folders of links, folders that contain themselves, names that no terminal should print."""

    def links(folder):
        (folder / "bad").mkdir()
        for path in run.iterdir():
            (folder / "bad" / path.name).symlink_to(path)
        return ["verify", "bad"]

    def contains_itself(folder):
        (folder / "bad").mkdir()
        (folder / "bad" / "again").symlink_to(".", target_is_directory=True)
        return ["runs", "bad"]

    def many_files(folder):
        (folder / "bad").mkdir()
        for number in range(3000):
            (folder / "bad" / f"{number}.csv").write_text("x")
        return ["calibrate", "bad"]

    def only_pipes(folder):
        (folder / "bad").mkdir()
        for ending in ("raw", "csv", "png", "tiff"):
            os.mkfifo(folder / "bad" / f"a.{ending}")
        return ["calibrate", "bad"]

    def capture_elsewhere(folder):
        _copy_run(run, folder / "bad")
        for capture in list((folder / "bad" / "captures").iterdir()):
            capture.unlink()
            capture.symlink_to("/dev/zero")
        return ["calibrate", "bad"]

    yield Case("folder:links", links, (0, 1, 2), named=False)
    yield Case("folder:contains-itself", contains_itself, (0, 1, 2), named=False)
    for kind, reader, name, content in (
        ("escape-sequences", "calibrate-points", "\x1b]0;owned\x07\x1b[2J\n\u202etxt.csv", "1 2 3\n"),
        ("not-utf-8", "calibrate-points", os.fsdecode(b"\xff\xfe.csv"), "1 2 3\n"),
        ("yaml", "plan-sequence", "a\nb\x1b[31m.yaml", "format: x\n"),
    ):
        yield Case(f"name:{kind}", _file(READERS[reader][0], name, text(content)), named=False)
    yield Case("folder:many-files", many_files, named=False)
    yield Case("folder:pipes", only_pipes, named=False)
    yield Case("folder:capture-elsewhere", capture_elsewhere, named=False)
    for name, words in {
        "long-path": ("plan", "x" * 5000, "--station", "simulated"),
        "nul-path": ("plan", "a\0b", "--station", "simulated"),
        "escape": ("plan", "\x1b[2J", "--station", "simulated"),
        "set-yaml": ("plan", "three_pose", "--station", "simulated", "--set", "sequence.name=!!python/x []"),
        "set-path": ("plan", "three_pose", "--station", "simulated", "--set", "a.b.c=1"),
        "set-long": ("plan", "three_pose", "--station", "simulated", "--set", "sequence.name=" + "[" * 5000),
        "trust-rubbish": ("keys", "trust", "\x1b[2J ssh-ed25519 AAAA"),
        "trust-long": ("keys", "trust", "x" * 100_000),
        "undistort-number": ("undistort", "bad", "-o", "a", "--keep", "1e-320"),
        "undistort-underscore": ("undistort", "bad", "-o", "a", "--keep", "1_0"),
        "image-size": ("calibrate", "points.csv", "--image-size", "99999999999x1"),
    }.items():
        yield Case(f"words:{name}", lambda _folder, words=words: list(words), named=False)


HOME_FILES = ("allowed_signers", "ledger.jsonl", "signing_key", "runs.sqlite", "outbox")


def homes(run: Path) -> Iterator[Case]:
    """The bench's own folder holds rubbish."""
    for file in HOME_FILES:
        for wrong in ("empty", "random", "fifo", "folder", "sparse", "endless-line", "link-to-itself"):
            for words in (["keys", "show"], ["runs"], ["messages"], ["verify", str(run)]):
                if hash_of(f"{file}{wrong}{words[0]}") % 2:
                    continue

                def make(folder, file=file, wrong=wrong, words=words):
                    (folder / "home").mkdir(mode=0o700)
                    WRONG[wrong](folder / "home" / file)
                    return list(words)

                yield Case(f"home:{words[0]}:{file}:{wrong}", make, (0, 1, 2), named=False)


def controls(run: Path) -> Iterator[Case]:
    """Inputs that are right: they must be taken."""

    def status(folder):
        _copy_run(run, folder / "good")
        return ["status", "good"]

    yield Case("control:plan", _file(READERS["plan-station"][0], "good.yaml", text(PLAIN)), (0,))
    yield Case("control:status", status, (0,))


def all_cases(run: Path) -> list[Case]:
    """All cases, in a fixed order; without `bench.extras`, those of its commands are left out."""
    cases = [*controls(run), *wrong_files(run), *spoilt_files(), *stations()]
    cases += [*run_folders(run), *odd_folders(run), *homes(run)]
    if find_spec("bench.extras") is None:
        return [case for case in cases if _EXTRAS.isdisjoint(re.split("[:-]", case.name))]
    return cases


def few_cases(run: Path) -> list[Case]:
    """A representative part: every kind of file, and every kind of wrong once or twice."""
    cases = all_cases(run)
    chosen = [case for case in cases if case.name.startswith("control:")]
    wanted = {f"{reader}:{wrong}" for reader in _FEW_READERS for wrong in FEW_WRONG}
    wanted |= {"run-folder:status:journal.jsonl:sparse", "run-folder:runs:journal.jsonl:fifo"}
    wanted |= {"camera:check:opencv-torn", "camera:rig:infinite-size", "camera:undistort:many-pixels"}
    wanted |= {"camera:step:fisheye", "station:limits-crossed", "station:spy-url"}
    wanted |= {"picture:bomb.png", "picture:loop.tif", "name:escape-sequences", "plan-sequence:tag"}
    return [*chosen, *(case for case in cases if case.name in wanted)]
