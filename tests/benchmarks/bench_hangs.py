"""How soon the supervisor of a batch notices a process that hangs, beside so many processes that compute without pause.

    python tests/benchmarks/bench_hangs.py [--beside 1 5 15 44] [--kinds blocks stopped computes keeps-gil healthy busy]

The process is a real worker: journal, heartbeat, command inbox. A healthy one works for 15 s; it must not be ended. A
busy one is healthy as well: it computes all the time, in pieces ten times as long as the longest one of a real run.
Prints seconds from the hang until it was noticed, and the load of the computer. Nothing computes for more than 60 s.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench.batch.supervisor as supervisor
from bench.base.clock import BenchClock

BURN = "import sys, time\nend = time.monotonic() + float(sys.argv[1])\nwhile time.monotonic() < end: pass"
WORKER = """
import os, re, signal, sys, time
from datetime import UTC, datetime
from pathlib import Path
from bench.base.clock import BenchClock
from bench.run.control import CommandInbox
from bench.run.heartbeat import HeartbeatWriter
from bench.records.history import RunLog
from bench.records.journal import Journal
from bench.records.run_folder import RunFolder
clock = BenchClock()
kind, moment = sys.argv[2], Path(sys.argv[3])
with RunFolder.create(Path(sys.argv[1])) as folder:
    with Journal.create(folder.journal_path, utc_now=clock.utc_now, monotonic=clock.monotonic) as journal:
        heartbeat = HeartbeatWriter(folder.path, clock)
        with CommandInbox(folder.path, RunLog(journal), {}, clock, (heartbeat.beat,)):
            heartbeat.entering("recording")
            clock.sleep(1.5)
            moment.write_text(str(time.monotonic()))
            if kind == "blocks":
                os.read(os.pipe()[0], 1)
            elif kind == "stopped":
                os.kill(os.getpid(), signal.SIGSTOP)
            elif kind == "computes":
                while True: pass
            elif kind == "keeps-gil":
                re.match("(a+)+$", "a" * 60 + "b")
            end_s = clock.monotonic() + 15.0
            while clock.monotonic() < end_s:
                clock.sleep(0.0 if kind == "busy" else 0.05)
                busy_s = time.thread_time() + (0.1 if kind == "busy" else 0.03)
                while time.thread_time() < busy_s: pass
"""


def measure(kind: str, beside: int, folder: Path) -> str:
    """Let one worker hang; return how that was noticed."""
    burners = [subprocess.Popen([sys.executable, "-c", BURN, "55"]) for _ in range(beside)]
    moment, noticed = folder / "moment", []
    ends_now = supervisor._end_now

    def noted(worker: object) -> None:
        noticed.append(time.monotonic())
        ends_now(worker)

    supervisor._end_now = noted
    try:
        end = supervisor.supervise(
            [sys.executable, "-c", WORKER, str(folder / "run"), kind, str(moment)],
            folder / "run",
            folder / "log",
            BenchClock(),
            print,
        )
    finally:
        supervisor._end_now = ends_now
        for burner in burners:
            burner.kill()
            burner.wait()
    after = f"{noticed[0] - float(moment.read_text()):5.1f} s" if noticed else "never  "
    return f"{after} {end.how:9} {end.why}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--beside", type=int, nargs="+", default=[1, 5, 15, 44])
    parser.add_argument(
        "--kinds", nargs="+", default=["blocks", "stopped", "computes", "keeps-gil", "healthy", "busy"]
    )
    parser.add_argument("--times", type=int, default=1)
    given = parser.parse_args()
    print("kind       beside  noticed  end       why; load of the last minute")
    for beside in given.beside:
        for kind in given.kinds * given.times:
            with tempfile.TemporaryDirectory() as folder:
                told = measure(kind, beside, Path(folder))
            print(f"{kind:10} {beside:6}  {told}; {os.getloadavg()[0]:.1f}", flush=True)


if __name__ == "__main__":
    main()
