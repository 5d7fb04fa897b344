"""Measure the table and the charts of many runs of two benches: time, memory and size, first and second call.

    python tests/benchmarks/bench_runs_table.py [--runs N]

The run folders have journals of six poses, with valid chains, and are not sealed. Each call is a process of its own, as
at the command line; its time includes the start of Python.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from datetime import timedelta
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from many_runs import BEGIN, SIGMAS, VALUES, BenchOfRuns


def make_benches(folder: Path, runs: int) -> list[Path]:
    """Write the runs of two benches; cx drifts on the second one."""
    rng, homes = np.random.default_rng(1), []
    for place in range(2):
        bench = BenchOfRuns(folder / f"home-{place}", folder / f"runs-{place}", station=f"Bench {place + 1}")
        for n in range(runs // 2):
            values = {name: VALUES[name] + 0.8 * SIGMAS[name] * rng.normal() for name in VALUES}
            values["cx"] += 0.002 * n * place
            bench.run(
                begun=BEGIN + timedelta(hours=1.5 * n + 0.7 * place), serial=f"{50001 + n % 40:08}", values=values,
                temperature_c=41.5 + 3.0 * np.sin(n / 300) + rng.normal(0, 0.2), poses=6,
            )  # fmt: skip
        homes.append(bench.close())
    return homes


def measure(what: str, words: list[str], home: Path, made: Path) -> None:
    """Run the command once, and print what it took."""
    begun = time.perf_counter()
    environment = {**os.environ, "STARBENCH_HOME": str(home)}
    command = [sys.executable, "-m", "bench", "runs", *words]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    took_s, cpu_s = time.perf_counter() - begun, used.ru_utime + used.ru_stime
    size = made.stat().st_size / 1e6 if made.exists() else 0.0
    last = told.strip().rpartition("\n")[2]
    peak_mb = used.ru_maxrss / 1e3
    print(f"{what:28} {took_s:6.2f} s  {cpu_s:6.2f} s CPU  peak {peak_mb:4.0f} MB  {size:6.2f} MB  {last}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5000)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        homes = make_benches(folder, runs)
        ledgers = [word for home in homes for word in ("--ledger", str(home))]
        table, csv, page = (folder / made for made in ("runs.parquet", "runs.csv", "charts.html"))
        home = folder / "here"
        measure("parquet, no index yet", [*ledgers, "--output", str(table)], home, table)
        measure("parquet, second call", [*ledgers, "--output", str(table)], home, table)
        measure("csv", [*ledgers, "--output", str(csv)], home, csv)
        measure("charts of cx", [*ledgers, "--chart", "cx", "--output", str(page)], home, page)
        measure("charts of all parameters", [*ledgers, "--chart", "--output", str(page)], home, page)


if __name__ == "__main__":
    main()
