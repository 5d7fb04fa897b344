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
"""Pictures with a new edge width at which the person looks after each action."""


@dataclass
class BlindFollower:
    """Stands before a simulated bench and obeys."""

    ring: float  # Vergence of the distance of focus, 1/m
    angles: dict[str, float]
    roll_deg: float = 0.4
    level: float = 100.0
    on: bool = False
    turn: float = FIRST_TURN  # Last turn of the ring, 1/m
    said: list[str] = field(default_factory=list)
    turned: bool = False  # Whether the last action has turned the stage

    def truth(self) -> Truth:
        """Return the bench as it stands."""
        lens = LensTruth(focus_distance_m=1.0 / self.ring if abs(self.ring) > 1e-6 else None)
        return dataclasses.replace(bench(roll_deg=self.roll_deg), lens=lens)

    def align(self, station: Station, folder: Path, *, most: int = 30, period_s: float = 1.0) -> LiveFigures:
        """Obey until there is nothing to do, or for ``most`` actions; return the last figures."""
        meter, time_s = LiveMeter(stars_every_s=0.0), 0.0
        path = folder / "slice.raw"
        figures = LiveFigures()
        for _ in range(most + 1):
            looks = 0
            for number in range(4 * PICTURES):
                moving = self.turned and number == 0
                light = drive(self.level, output=self.on, sync=self.on)
                share = seen(self.truth(), **self.angles)
                write_slice(path, share, light=light, seed=round(time_s), triggers=self.on)
                setting = LiveSetting.of_station(
                    station, frequency_hz=60.0, light_on=self.on, level_percent=self.level
                )
                part = LiveSlice(path, time_s, None, dict(self.angles), moving)
                _, figures = meter.measure(part, setting)
                time_s += period_s
                if moving:
                    assert figures.advice == (TURNING,)
                looks += "stars" in figures.took_ms  # a slow computer does not search in each picture
                if not self.on or looks >= PICTURES:
                    break
            if not figures.advice:
                break
            self.obey(figures.advice[0])
        return figures

    def obey(self, first: str) -> None:
        """Do what a sentence says. Raises AssertionError if nobody can do it."""
        self.said.append(first)
        self.turned = False
        if "switch" in first and "on" in first and not self.on:
            self.on = True
        elif "level to 100 %" in first:
            self.level = 100.0
        elif "urn the focus ring" in first:
            if by := re.search(r"turn (on|back) by about ([\d.]+) times the last turn", first):
                self.turn *= float(by[2]) * (1.0 if by[1] == "on" else -1.0)
            if not NEAREST >= self.ring + self.turn >= FARTHEST:  # the ring is at its end: the other way
                self.turn = -self.turn
            self.ring = min(max(self.ring + self.turn, FARTHEST), NEAREST)
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
