"""Hostile inputs for every command that reads a file, each run in a process of its own.

    python tests/support/hostile_inputs.py FOLDER RUN [--only TEXT] [--few]

FOLDER is new; RUN is the folder of a solved run. Prints one JSON object a line: name, status, what was said, memory
above the base in MB, time of the processor in s, and what is wrong with it. All the work is done by the real command
line. It is loaded once; every case is a fork of it, because 400 starts of the interpreter would take ten minutes.
"""

import argparse
import json
import os
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

from hostile_cases import Case, all_cases, few_cases
from hostile_files import GEOMETRY

MOST_MB, MOST_CPU_S, MOST_WALL_S = 200, 10, 30
_TEXT_LIMIT = 20_000
_ADDRESS_SPACE = 4 << 30


def prints(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of every file below a folder."""
    prints_of = {}
    for at, folders, files in os.walk(folder):
        for name in (*folders, *files):
            facts = (Path(at) / name).lstat()
            prints_of[str(Path(at) / name)] = (facts.st_size, facts.st_mtime_ns)
    return prints_of


def _child(case: Case, folder: Path, words: list[str]) -> None:
    from bench.commands.cli import main

    os.chdir(folder)
    os.environ.update(
        STARBENCH_HOME=str(folder / "home"), STARBENCH_LOCKS=str(folder / "locks"), COLUMNS="200"
    )
    for number, name in ((1, "stdout"), (2, "stderr")):
        descriptor = os.open(folder / name, os.O_CREAT | os.O_WRONLY)
        os.dup2(descriptor, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (_address_space_now() + _ADDRESS_SPACE, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (2 << 30, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    status = 99
    try:
        main(words)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 98
    except BaseException:  # noqa: BLE001 - told as what is wrong with the case
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _address_space_now() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _wait(pid: int) -> tuple[int, resource.struct_rusage, bool]:
    end = time.monotonic() + MOST_WALL_S
    while time.monotonic() < end:
        ended_pid, status, usage = os.wait4(pid, os.WNOHANG)
        if ended_pid:
            return status, usage, False
        time.sleep(0.005)
    os.killpg(pid, signal.SIGKILL)
    _, status, usage = os.wait4(pid, 0)
    return status, usage, True


def base_kb() -> int:
    """Peak memory of a fork that does nothing."""
    if not (pid := os.fork()):
        os._exit(0)
    return os.wait4(pid, 0)[2].ru_maxrss


def run_case(case: Case, where: Path, watched: Path) -> dict[str, object]:
    """Do one case; return what came of it."""
    folder = where / "case"
    folder.mkdir()
    (folder / "second").mkdir()
    for name in ("points.csv", "second/points.csv"):
        (folder / name).write_text("".join(f"{n * 7} {n * 5} {n} {n} {n}\n" for n in range(50)))
    (folder / "camera.json").write_text(json.dumps(GEOMETRY))
    words = case.make(folder)
    before = prints(watched)
    base = base_kb()
    sys.stdout.flush()
    if not (pid := os.fork()):
        _child(case, folder, words)
    status, usage, hung = _wait(pid)
    streams = {
        name: (folder / name).read_bytes()[:_TEXT_LIMIT].decode("utf-8", "replace")
        if (folder / name).exists()
        else ""
        for name in ("stdout", "stderr")
    }
    report = {
        "name": case.name,
        "status": os.waitstatus_to_exitcode(status),
        "mb": round((usage.ru_maxrss - base) / 1024),
        "cpu_s": round(usage.ru_utime + usage.ru_stime, 2),
        "said": streams["stderr"] or streams["stdout"],
    }
    wrong = list(_wrong(case, report, words, streams, hung))
    if prints(watched) != before:
        wrong.append("a file outside was changed")
    if (folder / "executed").exists():
        wrong.append("code was executed")
    shutil.rmtree(folder)
    return {**report, "wrong": wrong}


def _wrong(case, report, words, streams, hung) -> Iterator[str]:
    both = streams["stdout"] + streams["stderr"]
    if hung:
        yield "it hung"
    if report["status"] not in case.exits:
        yield f"status {report['status']}"
    if "Traceback" in both or "defect" in both:
        yield "a traceback or a defect"
    if report["mb"] > MOST_MB:
        yield f"{report['mb']} MB"
    if report["cpu_s"] > MOST_CPU_S:
        yield f"{report['cpu_s']} s"
    if report["status"] and not both.strip():
        yield "nothing was said"
    if any((ord(letter) < 32 and letter not in "\n\t") or 0x7F <= ord(letter) < 0xA0 for letter in both):
        yield "a control character was printed"
    if len(both) > 6000:
        yield f"a message of {len(both)} characters"
    if report["status"] in (1, 2) and case.named and not any(word in both for word in words if "bad" in word):
        yield "the message does not name the file"


def main() -> None:
    """Do the cases that the arguments choose; print what came of each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--few", action="store_true")
    given = parser.parse_args()
    given.folder.mkdir(parents=True)
    watched = given.folder / "canary"
    watched.mkdir()
    (watched / "victim.txt").write_text("keep me\n")
    import bench.commands.calibrate
    import bench.commands.cli
    import bench.run.launch
    import bench.solve.offline
    import bench.solve.offline_folder  # noqa: F401 - loaded once, before the forks
    from bench.base.kernel_cache import set_kernel_cache

    set_kernel_cache(os.environ)
    choose = few_cases if given.few else all_cases
    for case in choose(given.run.resolve()):
        if given.only in case.name:
            print(json.dumps(run_case(case, given.folder, watched)), flush=True)


if __name__ == "__main__":
    main()
