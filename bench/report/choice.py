"""Which poses a report shows in pictures, where there are more than a reader looks at and a page can carry.

Knows the structure of results.json; no images. The choice follows from the results alone, so that the page can be
rendered again from them and still say the same.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MOST_PICTURES = 24
"""Poses pictured at most."""
_WORST = 3
_NOT_PASSED = ("fail", "marginal")
_POSE_OF_GATE = re.compile(r"pose (\d+): ")


@dataclass(frozen=True)
class PictureSelection:
    """Poses shown in pictures.

    Attributes
    ----------
    names
        Their names.
    shown, total
        How many there are, and of how many.
    """

    names: frozenset[str]
    shown: int
    total: int


def pictured_poses(results: Mapping[str, Any]) -> PictureSelection:
    """Choose the poses that a report pictures: all where they are few, else `MOST_PICTURES`.

    First come the three of the largest RMS residual, then poses with a failed gate, then those with a marginal one,
    then the others. Of a group that does not fit whole, poses evenly spread over the run are taken.

    Parameters
    ----------
    results
        Content of results.json; poses without stars in the calibration have no picture.

    Returns
    -------
    Choice
        The poses' names and how many they are.
    """
    poses = [pose for pose in results.get("poses") or [] if pose.get("rms_px") is not None]
    judged = _indices_by_verdict(results.get("gates") or [])
    worst_first = sorted(range(len(poses)), key=lambda place: (-poses[place]["rms_px"], place))
    groups = [
        worst_first[:_WORST],
        *([p for p, pose in enumerate(poses) if pose["index"] in judged[verdict]] for verdict in _NOT_PASSED),
        list(range(len(poses))),
    ]
    chosen: set[int] = set()
    for group in groups:
        chosen.update(_evenly_spread([p for p in group if p not in chosen], MOST_PICTURES - len(chosen)))
    return PictureSelection(frozenset(str(poses[place]["name"]) for place in chosen), len(chosen), len(poses))


def _indices_by_verdict(gates: Sequence[Mapping[str, Any]]) -> dict[str, set[int]]:
    """Indices of the poses with a gate judged so; gates of the whole run have no pose."""
    found: dict[str, set[int]] = {verdict: set() for verdict in _NOT_PASSED}
    for gate in gates:
        of_pose = _POSE_OF_GATE.match(str(gate["name"]))
        if of_pose and gate["verdict"] in found:
            found[gate["verdict"]].add(int(of_pose[1]))
    return found


def _evenly_spread(places: Sequence[int], most: int) -> Sequence[int]:
    """Take so many places at most, evenly spread, the first and the last among them."""
    if len(places) <= most:
        return places
    return [places[k * (len(places) - 1) // max(1, most - 1)] for k in range(most)]
