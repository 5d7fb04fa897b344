"""A person who only obeys the first sentence of the align page, from random starts: does it end, and after how many actions?

    python tests/benchmarks/bench_blind_follower.py [--starts N] [--only START ...] [--seed S] [--write]

A start is a distance of focus between 0.5 m and 3 m beyond infinity, pan and tilt within 6 and 4 degrees, any roll
within 20 degrees, a level of 20 to 100 %, and the light off; the stage is homed. The first turn of the ring goes either
way, the ring has two stops, and the person looks up 2, 5 or 10 s after each action. An action is one thing that was advised and done: the light, its level, a turn of the ring, a turn of the stage by at most 5 degrees, a
roll. Each picture is rendered, recorded as events and measured as on the page.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import measured
import numpy as np

from bench.stations.station import load_station
from simulators.optics.lens_focus import signed_blur_px
from tests.support.blind_follower import BlindFollower


def main() -> None:
    """Print a line a start, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=40)
    parser.add_argument("--only", type=int, nargs="+", help="the starts to do, by number")
    parser.add_argument("--seed", type=int, default=27)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    station = load_station("simulated").value
    counts, bad = [], 0
    print(
        "start  looks s  focus 1/m    pan   tilt   roll  level  first turn | actions  ring  stage  blur px  edge px  what stays"
    )
    for number in range(given.starts):
        person = BlindFollower(
            float(rng.uniform(-0.33, 2.0)),
            {"pan": float(rng.uniform(-6.0, 6.0)), "tilt": float(rng.uniform(-4.0, 4.0))},
            float(rng.uniform(-20.0, 20.0)),
            float(rng.uniform(20.0, 100.0)),
            turn=float(rng.choice([-0.25, 0.25])),
            looks_s=(2.0, 5.0, 10.0)[number % 3],
        )
        if given.only and number not in given.only:
            continue
        start = (
            f"{number:5d} {person.looks_s:8.0f} {person.ring:10.2f} {person.angles['pan']:6.1f} {person.angles['tilt']:6.1f}"
            f" {person.roll_deg:6.1f} {person.level:6.0f} {person.turn:11.2f}"
        )
        with tempfile.TemporaryDirectory() as folder:
            try:
                figures = person.align(station, Path(folder))
                left = "; ".join(figures.advice)
            except AssertionError as error:
                left = str(error)
        rings = sum("urn the focus ring" in line for line in person.instructions)
        stages = sum(line.startswith(("Turn pan", "Turn tilt")) for line in person.instructions)
        print(
            f"{start} | {len(person.instructions):7d} {rings:5d} {stages:6d} {signed_blur_px(person.truth()):8.2f}"
            f" {figures.focus.edge_width_px or float('nan'):8.2f}  {left[:90] or 'nothing'}",
            flush=True,
        )
        counts.append(len(person.instructions))
        bad += bool(left)
    print(
        f"{len(counts) - bad} of {len(counts)} end with nothing to do; actions: median {np.median(counts):g}, most {max(counts)}"
    )
    print(f"processor time {time.process_time():.0f} s")


if __name__ == "__main__":
    measured.run(main, "align", "A person who only obeys the first sentence")
