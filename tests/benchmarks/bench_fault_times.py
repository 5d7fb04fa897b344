"""From a fault of a simulated device to its line in the journal, to a message, and to the end of the run.

    python tests/benchmarks/bench_fault_times.py FOLDER [FAULT ...]

FOLDER is new. A real run in a process of its own uses a simulated bench in another process. The fault is ordered while
pose 2 is at work; a mail server in this process receives the messages. Prints a row for each fault: seconds after the
order, and what was told. The load of the computer stands in the last line.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import measured
from quick_runs import CONFIG, THREE, write_sequence, write_station_of
from running import PATIENCE_S, entering, journal, start
from servers import MailServer, serving

from bench.simulated import SimulatedBench

FAULTS = {
    "pan stall": "slewing",
    "pan limit": "slewing",
    "pan stop_short": "slewing",
    "pan no_progress": "slewing",
    "pan press_stop": "slewing",
    "gimbal unplug": "slewing",
    "gimbal lost": "slewing",
    "gimbal lost count=0": "slewing",
    "gimbal garbled count=0": "slewing",
    "light unplug": "recording",
    "light lost count=0": "recording",
    "light trip": "recording",
    "light lamp_open": "recording",
    "light no_sync": "recording",
    "camera unplug": "recording",
    "camera fault": "recording",
    "camera silence": "recording",
    "camera frames_lost count=3": "recording",
}
"""The order, and the state of pose 2 in which it is given."""


def told_by(lines: list[dict], since: int) -> str:
    """Return what the journal says of the fault; empty if it says nothing yet."""
    for line in lines[since:]:
        if line["event"] == "left_off" and line.get("error"):
            return line["error"]
        if line["event"] == "attempt_checked" and not line["accepted"]:
            return "; ".join(line["reasons"])
        if line["event"] == "attempt_lost":
            return line["why"]
        if line["event"] == "run_ended" and line["how"] != "finished":
            return line["why"]
    return ""


def measure(folder: Path, fault: str, state: str) -> str:
    """Do a run with one fault; return its row."""
    folder.mkdir()
    with serving(MailServer()) as server, SimulatedBench(CONFIG, 7) as bench:
        station = write_station_of(folder / "station.yaml", bench, server.section)
        sequence = write_sequence(folder / "sequence.yaml", THREE, attempts=1)
        run = folder / "run"
        process = start("run", sequence, "-s", station, "-o", run, home=folder / "home")
        while process.poll() is None and not any(map(entering(state, 2), journal(run))):
            time.sleep(0.005)
        since, began_s = len(journal(run)), time.monotonic()
        bench.order(fault)
        seen_s, message_s, what = None, None, ""
        while process.poll() is None and time.monotonic() < began_s + PATIENCE_S:
            now_s = time.monotonic() - began_s
            if seen_s is None and (what := told_by(journal(run), since)):
                seen_s = now_s
            if message_s is None and server.letters:
                message_s = now_s
            time.sleep(0.01)
        ended_s = time.monotonic() - began_s
        _, errors = process.communicate()
        if not journal(run):
            raise SystemExit(f"the run did not begin: {errors}")
        if message_s is None and server.letters:
            message_s = ended_s
    end = journal(run)[-1]
    states = ", ".join(f"{device['device']} {device['state']}" for device in end.get("devices", ()))
    after_s = (seen_s, message_s, ended_s)
    times = "".join("       -" if took_s is None else f" {took_s:7.1f}" for took_s in after_s)
    return f"{fault:28}{state:10}{times}  {end.get('how', '?'):9} {what[:110]!r} {states}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    given.folder.mkdir(parents=True)
    print(f"{'fault':28}{'in state':10} journal message     end  how       what")
    for number, fault in enumerate(FAULTS):
        print(measure(given.folder / f"{number:02}", fault, FAULTS[fault]), flush=True)
    print(json.dumps({"load": os.getloadavg()}))


if __name__ == "__main__":
    measured.run(main, "faults", "From a fault to a message")
