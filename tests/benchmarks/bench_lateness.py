"""How late a thread of a program is woken, beside so many processes that compute without pause.

python tests/benchmarks/bench_lateness.py [--seconds 15] [--beside 1 5 15]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time

from drivers.lateness import own_lateness

BURN = "import sys, time\nend = time.monotonic() + float(sys.argv[1])\nwhile time.monotonic() < end: pass"


def main() -> None:
    """Print the time that was lost, and the longest single delay."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--beside", type=int, nargs="+", default=[1, 5, 15])
    given = parser.parse_args()
    lateness = own_lateness()
    print("beside  lost s  longest s so far")
    for beside in given.beside:
        burners = [
            subprocess.Popen([sys.executable, "-c", BURN, str(given.seconds + 1.0)]) for _ in range(beside)
        ]
        time.sleep(1.0)
        before_s = lateness.lost_s()
        time.sleep(given.seconds)
        print(f"{beside:6} {lateness.lost_s() - before_s:7.2f} {lateness.longest_s:10.2f}")
        for burner in burners:
            burner.wait()


if __name__ == "__main__":
    main()
