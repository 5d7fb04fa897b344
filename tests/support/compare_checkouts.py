"""Run an old checkout and a new one on the same inputs, seeds and clock, and compare all that a user can see.

    python tests/support/compare_checkouts.py --old ../old --new . [--only NAME ...] [--work FOLDER] [--list]

It proves that a change of the program changed nothing else. Call it with the interpreter of the project's environment:
both sides run with it, each with its own checkout on PYTHONPATH, its own home, folder for temporary files and devices.

**What is done.** Each scenario (`comparison/scenarios.py`) is a list of commands, given to `python -m bench` as an
operator would: runs of the shipped sequences on the simulated bench, frames, boards, a batch with a job that fails, a
killed and resumed run, a rehearsed night, recalculation, a certificate, some fifty bad files, and some eighty short
commands. The inputs of both sides come from the old checkout. The simulated bench draws its noise from the seed, so the
same program gives the same events to the last byte, whatever the computer's speed. Only the public command line is
used: the program may be built in another way inside.

**What is compared.** Every file that a scenario leaves: each value of each JSON file, with sigmas and covariances; each
entry of the journals, and their order; each dataset of `views.h5`; exports, reports and certificates, line by line;
recordings; all bytes on the serial lines; and of each command its exit status, its output and its errors. Numbers are
the same only to the last bit; where they are not, the relative difference is told. The places look like

    nine_pose: run/results.json/calibration/camera/fx: 1671.2 -> 1671.3 (relative 6e-05)
    bad_inputs: said/unknown-key.stderr: lines differ ...

**What may vary** is replaced by its name before the comparison: the rules are in `comparison/rules.py` (times, hashes
that follow from them, folders, names of processes) and `comparison/wire.py` (how often a moving stage was asked). PDF
pages and signatures hold times inside; of them only the kind is compared, and `certificate.json` and `.xml` in full.

**What differs on purpose** is listed in `expected_differences.yaml`, with scenario, place (both may hold `*`) and
reason; `says` is a pattern that the difference must hold, and `relative` the largest relative difference of a number:

    - {scenario: "*", place: "*/results.json/calibration/*", relative: 1.0e-9, reason: one search loop (issue 25)}
    - {scenario: bad_inputs, place: said/unknown-key.stderr, says: "windowms", reason: the message names the line}

Differences that an entry explains are printed in one line for each entry. Any other is printed in full, and makes the
exit status 1. An entry that explains nothing is named: it is stale, or a scenario was not played.

**Time.** A side takes about ten minutes of the processor, more where kernels are still to be compiled. What the sides
left is kept in the work folder (default: `$TMPDIR/starbench-comparison`), and a side is played again only if its program
or the scenarios have changed. So the old side costs its time once; its folder may be copied into another work folder. `--again` plays all. A
scenario that breaks is told as a difference, and the others are played.

**A new scenario** is a function in `comparison/scenarios.py`: it writes its inputs and gives its commands. Play it with
`--old` and `--new` on the same checkout first. If anything differs then, it needs a rule, or has found a fault.
"""

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from comparison.differences import Difference, Expected, compare, read_expected, sort_out
from comparison.reading import read_folder
from comparison.scenarios import SCENARIOS, Scenario
from comparison.sides import Side, program_hash

EXPECTED = Path(__file__).with_name("expected_differences.yaml")
_DONE = "played.txt"


def main(words: list[str] | None = None) -> int:
    options = _options(words)
    played = [scenario for scenario in SCENARIOS if not options.only or scenario.name in options.only]
    old = options.old.resolve()
    sides = [
        Side(name, path.resolve(), options.work / name) for name, path in (("old", old), ("new", options.new))
    ]
    marks = {side.name: _mark(side, old) for side in sides}
    expected, sorted_out = read_expected(EXPECTED), []
    for scenario in played:
        try:
            left = [_play(side, scenario, old, marks[side.name], again=options.again) for side in sides]
        except (RuntimeError, OSError, subprocess.SubprocessError) as error:
            sorted_out.append((Difference(scenario.name, "(scenario)", f"cannot be played: {error}"), None))
            continue
        read = [read_folder(side.folder, side.folders()) for side in left]
        differences = compare(scenario.name, *read)
        sorted_out += sort_out(differences, expected)
        print(f"{scenario.name}: {len(read[0])} places, {len(differences)} differ", flush=True)
    return _tell(sorted_out, expected)


def _options(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Compare what two checkouts do. The head of the file says more."
    )
    parser.add_argument("--old", type=Path, required=True, help="checkout that is right by definition")
    parser.add_argument("--new", type=Path, default=Path(), help="checkout to compare with it")
    names = [scenario.name for scenario in SCENARIOS]
    parser.add_argument(
        "--only", nargs="+", choices=names, default=[], help="scenarios to play; default: all"
    )
    work = Path(tempfile.gettempdir()) / "starbench-comparison"
    parser.add_argument("--work", type=Path, default=work, help="folder for what both sides leave")
    parser.add_argument(
        "--again", action="store_true", help="play both sides again, though nothing has changed"
    )
    options = parser.parse_args(words)
    options.work = options.work.resolve()
    return options


def _mark(side: Side, old: Path) -> str:
    """What a side's folder depends on: program, inputs, scenarios, interpreter."""
    rooms = Path(__file__).parent / "comparison"
    own = b"".join((rooms / f"{name}.py").read_bytes() for name in ("inputs", "scenarios", "sides"))
    inputs = program_hash(old)
    return (
        f"{program_hash(side.checkout)} {inputs} {hashlib.sha256(own).hexdigest()} {sys.version.split()[0]}"
    )


def _play(side: Side, scenario: Scenario, old: Path, mark: str, *, again: bool) -> Side:
    """The side in the folder of a scenario, played now or before."""
    done = side.folder / f"{scenario.name}.{_DONE}"
    if not again and done.exists() and done.read_text().partition("\n")[0] == mark:
        played_at = done.read_text().splitlines()[1]
        return Side(side.name, side.checkout, side.folder / scenario.name, played_at)
    done.unlink(missing_ok=True)
    side.warm()
    begun, inside = time.monotonic(), side.enter(scenario.name)
    scenario.play(inside, old)
    done.write_text(f"{mark}\n{inside.folder}\n")
    print(f"  {scenario.name}, {side.name}: played in {time.monotonic() - begun:.0f} s", flush=True)
    return inside


def _tell(sorted_out: list[tuple[Difference, str | None]], expected: list[Expected]) -> int:
    """Print what differs; return the exit status."""
    for reason, count in Counter(reason for _, reason in sorted_out if reason is not None).items():
        print(f"on purpose: {reason}: {count} places")
    surprises = [difference for difference, reason in sorted_out if reason is None]
    for difference in surprises:
        print(difference)
    for entry in expected:
        if not entry.matched:
            print(f"explains nothing: {entry.scenario}: {entry.place}: {entry.reason}")
    print(f"{len(surprises)} differences that nobody announced" if surprises else "nothing else differs")
    return 1 if surprises else 0


if __name__ == "__main__":
    sys.exit(main())
