"""One side of the comparison: a checkout, its own home and folders, and what its commands say."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

PATIENCE_S = 3600.0
#: Calls `python -m bench` once for each command of a list, each in a fork of one process that has loaded all of it.
_MANY = """
import contextlib, importlib, json, os, pkgutil, runpy, sys
import bench
for module in pkgutil.walk_packages(bench.__path__, "bench."):
    if not module.name.endswith("__main__"):
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)
for number, words in json.load(open(sys.argv[1])):
    child = os.fork()
    if not child:
        for name, stream in (("stdout", 1), ("stderr", 2)):
            os.dup2(os.open(f"{number}.{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        sys.argv = ["bench", *words]
        try:
            runpy.run_module("bench", run_name="__main__", alter_sys=True)
        finally:
            sys.stdout.flush()
    open(f"{number}.exit", "w").write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\\n")
"""


@dataclass
class Side:
    """A checkout at work in a folder of its own; `name` is `old` or `new`, so that paths have equal lengths."""

    name: str
    checkout: Path
    folder: Path
    played_at: str = ""  # where the folder was when the commands ran, if it was copied since
    _count: int = field(default=0, init=False)

    def enter(self, scenario: str) -> "Side":
        """A side of this checkout in an empty folder for one scenario."""
        folder = self.folder / scenario
        remove(folder)
        (folder / "tmp").mkdir(parents=True)
        return Side(self.name, self.checkout, folder)

    def warm(self) -> None:
        """Compile the kernels, in a process of their own.

        A process that compiles a kernel itself has more copies of it than one that reads it from the disk, and may call
        another copy; a sum in another order then moves stars by some 1e-6 px.
        """
        self.enter("warming")
        inside = Side(self.name, self.checkout, self.folder / "warming")
        words = [sys.executable, "-m", "bench.warm_up"]
        how = {"env": inside.environment(), "cwd": inside.folder, "timeout": PATIENCE_S}
        subprocess.run(words, capture_output=True, check=True, **how)

    def environment(self) -> dict[str, str]:
        home = self.folder / "home"
        kept = {name: value for name, value in os.environ.items() if not name.startswith("STARBENCH_")}
        return {
            **kept, "HOME": str(home), "TMPDIR": str(self.folder / "tmp"), "STARBENCH_HOME": str(home),
            "STARBENCH_LOCKS": str(self.folder / "locks"), "PYTHONPATH": str(self.checkout), "USER": "operator",
            "LOGNAME": "operator", "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "100", "TZ": "UTC", "LC_ALL": "C.UTF-8",
            "PYTHONHASHSEED": "0", "TERM": "dumb",
        }  # fmt: skip

    def folders(self) -> list[tuple[str, str]]:
        """What normalising replaces: the folder of this side, and its checkout."""
        return [(self.played_at or str(self.folder), "folder"), (str(self.checkout), "checkout")]

    def write(self, name: str, text: str) -> str:
        (self.folder / name).write_text(text, encoding="utf-8")
        return name

    def say(self, *words: object) -> int:
        """Run one command to its end and keep what it said under `said/`; return its exit status."""
        process = self.start(*words)
        return self._keep(process, [str(word) for word in words], *process.communicate(timeout=PATIENCE_S))

    def start(self, *words: object) -> subprocess.Popen[str]:
        self.folder.mkdir(parents=True, exist_ok=True)
        return subprocess.Popen(
            [sys.executable, "-m", "bench", *map(str, words)],
            env=self.environment(), cwd=self.folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip

    def kill_at(self, reached: Callable[[dict], bool], run: str, *words: object) -> None:
        """Begin a command and kill it once the journal of `run` shows an entry; the journal then ends with it.

        Entries that came while the process was being killed are cut off, as a power cut at that moment would have done.
        """
        process, journal = self.start(*words), self.folder / run / "journal.jsonl"
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and process.poll() is None:
            lines = journal.read_text().split("\n")[:-1] if journal.exists() else []
            there = next((number for number, line in enumerate(lines) if reached(json.loads(line))), None)
            if there is not None:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                journal.write_text("".join(f"{line}\n" for line in lines[: there + 1]))
                return
            time.sleep(0.003)
        process.kill()
        raise RuntimeError(f"{words}: ended before the entry was there: {process.communicate()[1]}")

    def say_many(self, commands: dict[str, list[str]]) -> None:
        """Run short commands, each in a fork of one process; the dictionary names them."""
        folder = self.folder / "said"
        folder.mkdir(exist_ok=True)
        listed = [[str(folder / name), words] for name, words in commands.items()]
        self.write("tmp/commands.json", json.dumps(listed))
        subprocess.run(
            [sys.executable, "-c", _MANY, str(self.folder / "tmp" / "commands.json")],
            env=self.environment(), cwd=self.folder, stdin=subprocess.DEVNULL, check=True, timeout=PATIENCE_S,
        )  # fmt: skip
        for name, words in commands.items():
            self._sort_json(folder / name, words)

    def _keep(self, process: subprocess.Popen[str], said_words: list[str], out: str, err: str) -> int:
        self._count += 1
        folder = self.folder / "said"
        folder.mkdir(exist_ok=True)
        words = [word for word in said_words if not word.startswith("-")]
        stem = folder / f"{self._count:02d}-{words[0]}"
        for name, text in (("stdout", out), ("stderr", err), ("exit", f"{process.returncode}\n")):
            stem.with_name(f"{stem.name}.{name}").write_text(text, encoding="utf-8")
        self._sort_json(stem, said_words)
        return process.returncode

    @staticmethod
    def _sort_json(stem: Path, words: list[str]) -> None:
        """What a command printed as JSON is compared value by value."""
        if "--json" in words or words[:1] == ["schema"]:
            printed = stem.with_name(f"{stem.name}.stdout")
            printed.rename(stem.with_name(f"{stem.name}.stdout.json")) if printed.stat().st_size else None


def remove(folder: Path) -> None:
    """Remove a folder; sealed runs in it are read-only."""
    if folder.exists():
        for path in (folder, *folder.rglob("*")):
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o700)
        shutil.rmtree(folder)


def program_hash(checkout: Path) -> str:
    """Hash of all that a checkout runs: its sources and the files shipped with them."""
    digest = hashlib.sha256()
    for room in ("bench", "calib", "drivers", "sequences", "simulators"):
        for path in sorted((checkout / room).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(f"{path.relative_to(checkout)}\n".encode() + path.read_bytes())
    return digest.hexdigest()
