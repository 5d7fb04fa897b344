"""A person who does what the first sentence of the align page's advice says, and knows nothing else about the bench."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass, field
from pathlib import Path

from bench.align.live_figures import TURNING, LiveFigures, LiveMeter, LiveSetting, LiveSlice
from bench.stations.station import Station
from simulators.world.truth import LensTruth, Truth
from tests.support.live_slices import bench, drive, seen, write_slice

FIRST_TURN = 0.25
"""First turn of the focus ring, 1/m: 9 degrees of the ring of the simulated lens."""
NEAREST, FARTHEST = 2.4, -0.33
"""Ends of the focus ring, 1/m."""
LARGEST_TURN_DEG = 5.0
"""What **Turn there** turns at most."""
PICTURES = 4
"""Pictures that come before the person looks up after each action; the first shows the ring half way."""
FIRMLY = 0.004
"""Smallest turn of the ring that a hand notices, 1/m: 0.15 degrees of the ring of the simulated lens."""


@dataclass
class BlindFollower:
    """Stands before a simulated bench and obeys."""

    ring: float  # Vergence of the distance of focus, 1/m
    angles: dict[str, float]
    roll_deg: float = 0.4
    level: float = 100.0
    on: bool = False
    turn: float = FIRST_TURN  # Last turn of the ring, 1/m
    looks_s: float = 4.0  # Time after an action at which the person looks up, s
    instructions: list[str] = field(default_factory=list)
    turned: bool = False  # Whether the last action has turned the stage
    ring_before: float | None = (
        None  # Where the ring stood before the last action, 1/m; None if it was another one
    )
    waited_s: float = 0.0  # Time since the last action, s
    last_was_ring: bool = False  # Whether the last action was a turn of the ring
    at_stop: bool = False  # Whether the last turn has ended at the end of the ring's travel

    def truth(self, ring: float | None = None) -> Truth:
        """Return the bench as it stands, or with the ring elsewhere, 1/m."""
        ring = self.ring if ring is None else ring
        lens = LensTruth(focus_distance_m=1.0 / ring if abs(ring) > 1e-6 else None)
        return dataclasses.replace(bench(roll_deg=self.roll_deg), lens=lens)

    def align(self, station: Station, folder: Path, *, most: int = 30) -> LiveFigures:
        """Obey until there is nothing to do, or for ``most`` actions; return the last figures."""
        meter, time_s = LiveMeter(stars_every_s=0.0), 0.0
        path = folder / "slice.raw"
        figures = LiveFigures()
        while len(self.instructions) <= most:
            looks = 0
            for number in range(4 * PICTURES):
                moving = self.turned and number == 0
                between = self.ring_before is not None and number == 0
                truth = self.truth((self.ring + self.ring_before) / 2 if between else None)
                light = drive(self.level, output=self.on, sync=self.on)
                write_slice(
                    path, seen(truth, **self.angles), light=light, seed=round(10 * time_s), triggers=self.on
                )
                setting = LiveSetting.of_station(
                    station, frequency_hz=60.0, light_on=self.on, level_percent=self.level, homed=True
                )
                part = LiveSlice(path, time_s, None, dict(self.angles), moving)
                _, figures = meter.measure(part, setting)
                time_s += self.looks_s / PICTURES
                self.waited_s += self.looks_s / PICTURES
                if moving:
                    assert figures.advice == (TURNING,)
                looks += "stars" in figures.took_ms  # a slow computer does not search in each picture
                if not self.on or looks >= PICTURES:
                    break
            self.turned, self.ring_before = False, None
            if not figures.advice:
                break
            if figures.ring is None or figures.ring.way != "wait":
                self.obey(figures)
                self.waited_s = 0.0
                if self.at_stop:
                    meter.at_stop()
        return figures

    def obey(self, figures: LiveFigures) -> None:
        """Do what the first sentence says. Raises AssertionError if nobody can do it."""
        first = figures.advice[0]
        self.instructions.append(first)
        before, self.last_was_ring = (
            self.last_was_ring,
            "urn the focus ring" in first and figures.ring is not None,
        )
        if "switch" in first and "on" in first and not self.on:
            self.on = True
        elif "level to 100 %" in first:
            self.level = 100.0
        elif "urn the focus ring" in first:
            unchanged_s = figures.focus.unchanged_s
            self._turn_ring(first, unseen=before and unchanged_s is not None and unchanged_s >= self.waited_s)
        elif turns := re.findall(r"(pan|tilt) by (?:about )?([-+][\d.]+) degrees", first):
            self.turned = True
            for axis, by_deg in turns:
                self.angles[axis] += max(-LARGEST_TURN_DEG, min(LARGEST_TURN_DEG, float(by_deg)))
        elif "about 10 degrees, in either direction" in first:
            self.roll_deg += 10.0
        elif rolled := re.search(r"turned (clockwise|counter-clockwise) by (\d+) degrees", first):
            self.roll_deg += float(rolled[2]) * (1.0 if rolled[1] == "clockwise" else -1.0)
        else:
            raise AssertionError(f"Nobody can do this: {first}")

    def _turn_ring(self, first: str, *, unseen: bool) -> None:
        """Turn the ring as a sentence says; ``unseen``: the last turn has changed nothing."""
        by = re.search(r"turn (on|back) by about ([\d.]+) times the last turn", first)
        if self.at_stop:
            self.turn *= -(float(by[2]) if by else 2.0)
        elif "too small to be seen" in first and unseen:
            self.turn *= 2.0
        elif by:
            self.turn *= float(by[2]) * (1.0 if by[1] == "on" else -1.0)
        wanted = self.ring + self.turn
        reached = min(max(wanted, FARTHEST), NEAREST)
        self.at_stop = reached != wanted
        if abs(reached - self.ring) > FIRMLY:
            self.turn = reached - self.ring
        self.ring_before, self.ring = self.ring, reached
