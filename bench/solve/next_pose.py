"""The next pose of an ``until``: among the poses that the stage reaches, the one that lowers most what is too wide.

They are a grid where the camera sees enough of the target, and a finer one around its best pose. No chance is used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bench.solve.forecasts import (
    LARGEST_ROLL_DEG,
    SMALLEST_COVERAGE_FACTOR,
    expected_bench,
    pose_grid,
)
from bench.solve.solve_options import stated_radial_sigma
from bench.stations.sections import AxisConfig
from bench.stations.station import Station
from bench.wording.goals import beside_goal, meaning_of_goal
from calib.engine import Calibration
from calib.model.collimator import Collimator
from calib.model.gimbal import Gimbal
from calib.model.gimbal_readings import GimbalReadings
from calib.model.passport import Passport
from calib.studies.planning import PoseWeigher, WeighedPose, fit_gimbal
from calib.studies.pose_gains import Angles, Sigmas
from calib.studies.predicted_views import ExpectedBench
from sequences.reader import Located

Array = NDArray[np.float64]

GRID = {"pan_deg": 13, "tilt_deg": 9, "roll_deg": 7}
"""Poses along each axis, in each of the two grids: over the stage's range, and over the part that shows the target. A
finer one would take longer to weigh, and `REFINEMENTS` find the poses between."""
REFINEMENTS = (0.5, 0.25)
"""Steps of the finer grids around the best pose, in steps of the grid."""
ALIGNED_ROLL_DEG = 5.0
"""A pose avoids edges along the pixels if its roll differs by at least this from those recorded, degrees: errors of
edges are correlated at 0.5 degrees, and not at 10 (docs/stars.md)."""
MORE_STARS = 1.2
"""A chosen pose should show this many times the stars that its gate asks for: where it points is known to a degree or
so."""
LITTLE_GAIN = 0.95
"""A goal out of reach ends the step only if all allowed poses would leave more than this share of U: nobody needs the
rest."""
LATER_CANDIDATES = 100
"""Number of poses of the grid, about, from which all later poses are chosen for an expectation of the end: it bounds
the time of each choice."""


@dataclass(frozen=True)
class Choice:
    """The next pose."""

    angles_deg: Angles  # Angle by axis, degrees (``pan_deg``)
    # Expanded uncertainties, px, that are expected with this pose added, by name of the goal.
    expected: Mapping[str, float]
    # The same at the end: with as many poses as are allowed, each where it helps most.
    at_end: Mapping[str, float]
    # What the poses so far lack besides information: ``roll``, or nothing.
    lacks: Literal["", "roll"]
    why: str

    def hopeless(self, wanted: Mapping[str, float], now: Mapping[str, float]) -> str:
        """Return the goal that all allowed poses will miss most, even if they gain twice as much as is expected.

        Empty if they may meet each, if they still lower U, or if none is known. ``now`` are the expanded uncertainties
        reached, px.
        """
        least = {name: 2.0 * self.at_end[name] - now.get(name, np.inf) for name in wanted}
        shares = {name: least[name] / most for name, most in wanted.items()}
        missed = [name for name, share in shares.items() if 1.0 < share < np.inf]
        worst = max(missed, key=lambda name: shares[name], default="")
        return worst if worst and self.at_end[worst] > LITTLE_GAIN * now[worst] else ""


@dataclass(frozen=True)
class Wish:
    """What the next pose is chosen for."""

    wanted: Mapping[str, float]  # Goals: largest expanded uncertainties allowed, px, by name
    # Expanded uncertainties reached, px; empty if the camera is not determined yet.
    now: Mapping[str, float]
    roll: bool  # Whether the poses so far need another roll
    needs_tag: bool  # Whether the pose must show the whole tag
    min_stars: int  # Stars that a recording must have to be accepted
    more: int = 1  # Poses that may still be recorded


def choose_pose(
    station: Located[Station],
    calibration: Calibration | None,
    passport: Passport | None,
    *,
    taken_deg: Sequence[Angles],
    refused_deg: Sequence[Angles],
    wish: Wish,
    readings: GimbalReadings | None = None,
) -> Choice | str:
    """Choose the next pose.

    ``taken_deg`` are the poses of the calibration's views, ``refused_deg`` those that failed, ``readings`` the worth of
    the gimbal's, without angles, or None.
    """
    if calibration is None and station.value.expected is None:
        return (
            "The poses so far do not determine the camera, and the station file has no expected section, so no pose "
            "can be predicted."
        )
    bench = replace(
        _bench(station, calibration, taken_deg),
        passport=passport,
        needs_tag=wish.needs_tag,
        readings=readings,
    )
    gimbal = _gimbal(calibration, taken_deg)
    weigher = PoseWeigher(
        bench, gimbal, taken_deg, refused_deg=refused_deg, min_stars=int(MORE_STARS * wish.min_stars)
    )
    reached = _ranges(station.value.axes, bench, taken_deg)
    axes = _visible_part(reached, weigher.visible(pose_grid(reached)))
    grid = list(pose_grid(axes)) if axes else []
    weighed = weigher.weigh(grid)
    if not weighed:
        return "No pose within the limits of the stage shows enough of the target, besides those recorded."
    lacks: Literal["", "roll"] = "roll" if wish.roll and "roll" in station.value.axes else ""
    chosen = _best_of(weigher.before, weighed, wish, lacks, taken_deg)
    for share in REFINEMENTS:
        finer = weigher.weigh(_around(chosen.angles_deg, axes, share))
        chosen = _best_of(weigher.before, [chosen, *finer], wish, lacks, taken_deg)
    expected = _expected(weigher.before, chosen.after, wish)
    later = weigher.best(grid[:: max(1, len(grid) // LATER_CANDIDATES)], wish.more)
    lasts = [
        expected,
        *(_expected(weigher.before, uncertainties.after, wish) for uncertainties in later[-1:]),
    ]
    at_end = {name: min(uncertainties[name] for uncertainties in lasts) for name in expected}
    return Choice(_rounded(chosen.angles_deg), expected, at_end, lacks, _reason(wish, lacks))


def _bench(
    station: Located[Station], calibration: Calibration | None, taken_deg: Sequence[Angles]
) -> ExpectedBench:
    """Return the bench as it is known now: that of the last calibration, else the expected one."""
    value = station.value
    if calibration is None:
        assert value.expected is not None
        bench = replace(expected_bench(station), errors=value.expected.errors(value.collimator))
    else:
        bench = _found(value, calibration, len(taken_deg))
    return replace(bench, terms=value.budget.terms(value.collimator), radial_sigma=stated_radial_sigma(value))


def _found(station: Station, calibration: Calibration, poses: int) -> ExpectedBench:
    """Return the bench that a calibration found."""
    if calibration.collimator is not None:
        estimated = calibration.collimator
        collimator = Collimator(estimated.x, estimated.y, estimated.r)
    else:  # the planar model has a centre for each view
        x, y, z = (float(value) for value in calibration.centres.mean(axis=0))
        collimator = Collimator(x, y, abs(z))
    expected = station.expected
    return ExpectedBench(
        calibration.camera,
        collimator,
        expected.half_angle_deg if expected else _seen_half_angle_deg(calibration, poses),
        target=station.target.pattern(),
        amplitudes={amplitude.name: amplitude.plain for amplitude in calibration.amplitudes} or None,
    )


def _seen_half_angle_deg(calibration: Calibration, poses: int) -> float:
    """Return the half angle of the beam that the poses have reached, degrees: from the axis to the farthest corner."""
    width, height = calibration.camera.image_size
    corners = np.array([[0.0, 0.0], [width - 1.0, 0.0], [0.0, height - 1.0], [width - 1.0, height - 1.0]])
    rays = calibration.camera.rays(corners)
    along = [(rays @ rotation)[:, 2] for rotation in calibration.rotations[:poses]]
    return float(np.degrees(np.arccos(np.clip(np.nanmin(along), 0.2, 1.0))))


def _gimbal(calibration: Calibration | None, taken_deg: Sequence[Angles]) -> Gimbal:
    if calibration is None or len(calibration.rotations) != len(taken_deg):
        return Gimbal()
    return fit_gimbal(calibration.rotations, taken_deg)


def _ranges(
    axes: Mapping[str, AxisConfig], bench: ExpectedBench, taken_deg: Sequence[Angles]
) -> dict[str, Array]:
    """Return the angles of each axis that a first grid takes, degrees: where the camera can see into the beam."""
    width, height = bench.camera.image_size
    reach = bench.half_angle_deg + float(
        np.degrees(np.arctan(np.hypot(width / bench.camera.fx, height / bench.camera.fy) / 2))
    )
    ranges = {}
    for axis, config in axes.items():
        name = f"{axis}_deg"
        lowest, highest = config.limits_deg
        middle = float(np.mean([pose.get(name, 0.0) for pose in taken_deg])) if taken_deg else 0.0
        most = LARGEST_ROLL_DEG if axis == "roll" else reach
        lowest, highest = max(lowest, min(middle - most, highest)), min(highest, max(middle + most, lowest))
        ranges[name] = np.linspace(lowest, highest, GRID.get(name, GRID["pan_deg"]))
    return ranges


def _visible_part(axes: Mapping[str, Array], visible: Sequence[Angles]) -> dict[str, Array]:
    """Return a finer grid over the poses that show the target, and one step beyond them; empty if there are none."""
    if not visible:
        return {}
    visible_part = {}
    for name, angles in axes.items():
        step = float(angles[1] - angles[0])
        seen = [pose[name] for pose in visible]
        lowest, highest = max(angles[0], min(seen) - step), min(angles[-1], max(seen) + step)
        visible_part[name] = np.linspace(lowest, highest, len(angles))
    return visible_part


def _around(pose: Angles, axes: Mapping[str, Array], share: float) -> Iterator[dict[str, float]]:
    """Yield the neighbours of a pose at a share of the grid's step, within the grid."""
    ranges = {
        name: np.clip(
            pose[name] + share * float(angles[1] - angles[0]) * np.array([-1.0, 0.0, 1.0]),
            angles[0],
            angles[-1],
        )
        for name, angles in axes.items()
    }
    for near in pose_grid(ranges):
        if near != dict(pose):
            yield near


def _best_of(
    before: Sigmas | None,
    weighed: Sequence[WeighedPose],
    wish: Wish,
    lacks: str,
    taken_deg: Sequence[Angles],
) -> WeighedPose:
    """Return the pose with the smallest expected uncertainties; those that bring what is lacking come first."""
    bringing = [pose for pose in weighed if _brings(pose, lacks, taken_deg)]
    return min(bringing or weighed, key=lambda pose: _score(before, pose, wish))


def _brings(pose: WeighedPose, lacks: str, taken_deg: Sequence[Angles]) -> bool:
    if lacks == "roll":
        turned = [abs(pose.angles_deg["roll_deg"] - taken.get("roll_deg", 0.0)) % 45.0 for taken in taken_deg]
        return all(ALIGNED_ROLL_DEG <= angle <= 45.0 - ALIGNED_ROLL_DEG for angle in turned)
    return True


def _score(before: Sigmas | None, pose: WeighedPose, wish: Wish) -> tuple[float, float]:
    """Return what is compared: the widest expected uncertainty by its goal, and their sum."""
    expected = _expected(before, pose.after, wish)
    shares = {name: value / wish.wanted[name] for name, value in expected.items()}
    missed = [share for name, share in shares.items() if wish.now.get(name, np.inf) > wish.wanted[name]]
    return max(missed or shares.values()), sum(shares.values())


def _expected(before: Sigmas | None, after: Sigmas, wish: Wish) -> dict[str, float]:
    """Return the expanded uncertainties to expect: those that are reached shrink as the forecast does."""
    later = {"expanded_fx_px": after.fx_px, "worst_corner_px": after.worst_px}
    if before is None:
        return {name: SMALLEST_COVERAGE_FACTOR * later[name] for name in wish.wanted}
    earlier = {"expanded_fx_px": before.fx_px, "worst_corner_px": before.worst_px}
    return {
        name: wish.now[name] * later[name] / earlier[name]
        if name in wish.now
        else SMALLEST_COVERAGE_FACTOR * later[name]
        for name in wish.wanted
    }


def _rounded(angles_deg: Angles) -> dict[str, float]:
    """Return angles with two decimals, rounded towards zero, so that they stay within the limits of the stage."""
    return {name: float(np.trunc(100.0 * angle) / 100.0) for name, angle in angles_deg.items()}


def _reason(wish: Wish, lacks: str) -> str:
    if lacks == "roll":
        return "the edges of the stars run along the pixels; another roll makes their errors independent"
    missed = [name for name, goal in wish.wanted.items() if wish.now.get(name, np.inf) > goal]
    widest = max(missed, key=lambda name: wish.now.get(name, np.inf) / wish.wanted[name])
    return f"it lowers {meaning_of_goal(widest)} most"


def would_leave(name: str, goal: float, at_end: float, poses: int) -> str:
    """Return what all ``poses`` of an ``until`` are expected to leave of a goal out of reach, px."""
    return f"With all {poses} poses, {meaning_of_goal(name)} would still be about {beside_goal(at_end, goal, 2)} px."
