"""Search for faults of a gimbal: an axis that slipped, a single wrong pose, axes that are not at right angles.

A fault is found if the likelihood ratio (`calib.studies.gimbal_likelihood`) decides for it, whatever the number of
places where it was looked for. Two faults are also looked for together, because each can hide the other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special

from calib.model.likelihood_ratio import DECISIVE, needed
from calib.studies.gimbal_likelihood import Explanation, SeenRotations
from calib.studies.gimbal_model import Fault, FaultKind

_ROUNDS = 3
#: Number of the most promising hypotheses that are fitted.
_FITTED = 4
#: Poses that are needed to look for faults.
_FEWEST = 5


@dataclass(frozen=True)
class GimbalFault:
    """A fault of the gimbal, or of one pose, that the rotations show."""

    kind: FaultKind
    axis: int | None  # Index of the axis that slipped; None for the other kinds
    # Index of the first pose after the slip, or of the pose that does not fit; None for ``squareness``.
    pose: int | None
    # size_deg, sigma_deg: Size of the fault and its 1-sigma, degrees; for ``pose`` the angle it is off
    size_deg: float
    sigma_deg: float
    probability: float  # That there is no such fault
    # Kind of another fault that explains the data nearly as well; None if there is none.
    rival: FaultKind | None = None


def search_faults(
    seen: SeenRotations, first: Explanation, axes: tuple[int, ...]
) -> tuple[Explanation, tuple[GimbalFault, ...]]:
    """Add faults as long as the likelihood ratio decides for them; the most probable fault is first.

    Forward selection (Efroymson, 1960).
    """
    places = _places(len(seen.rotations), axes)
    number = Counter(fault.kind for fault in places)
    cost = {kind: needed(count) for kind, count in number.items()}
    current = first
    for _ in range(_ROUNDS if places else 0):
        known = current.fit.model.faults
        new = [fault for fault in places if fault not in known]
        tried = [(*known, *one) for count in (1, 2) for one in combinations(new, count)]
        worth = seen.likelihoods(current.fit, tried) - [_cost(one, cost) for one in tried]
        models = [replace(current.fit.model, faults=tried[k]) for k in np.argsort(-worth)[:_FITTED]]
        found = [current, *(seen.explain(model, current.fit) for model in models)]
        best = max(found, key=lambda one: one.likelihood - _cost(one.fit.model.faults, cost))
        if best is current:
            break
        current = best
    faults = [_described(seen, current, fault, places, cost) for fault in current.fit.model.faults]
    return current, tuple(sorted(faults, key=lambda fault: fault.probability))


def _places(count: int, axes: tuple[int, ...]) -> list[Fault]:
    """Return the faults that can be seen in a number of poses, with readings of some axes."""
    if count < _FEWEST:
        return []
    square = [Fault("squareness")] if {0, 1} <= set(axes) else []
    slips = [Fault("slip", axis, first) for axis in axes for first in range(2, count - 1)]
    return [*square, *slips, *(Fault("pose", pose=pose) for pose in range(count))]


def _cost(faults: Sequence[Fault], cost: Mapping[FaultKind, float]) -> float:
    """Return what 2 log(likelihood) must gain by faults, from what it must gain by one of each kind."""
    return sum(cost[fault.kind] for fault in faults)


def _described(
    seen: SeenRotations,
    found: Explanation,
    fault: Fault,
    places: Sequence[Fault],
    cost: Mapping[FaultKind, float],
) -> GimbalFault:
    """Return one of the faults found with its size, its uncertainty and its rival."""
    model = found.fit.model
    rows = model.of(fault, found.fit.estimator(found.scatter.whitening)[6:])
    spread = rows @ found.scatter.covariance @ rows.T
    value = model.of(fault, found.fit.values)
    size = float(value[0] if fault.size == 1 else np.linalg.norm(value))
    others = tuple(one for one in model.faults if one != fault)
    rivals = [(*others, one) for one in places if one.kind != fault.kind and one not in others]
    tried = [model.faults, others, *rivals]
    worth = seen.likelihoods(found.fit, tried) - [_cost(one, cost) for one in tried]
    worth[1] -= DECISIVE
    best = int(worth[2:].argmax()) if rivals else 0
    undecided = bool(rivals) and worth[2 + best] > worth[0] - DECISIVE
    return GimbalFault(
        fault.kind,
        fault.axis if fault.kind == "slip" else None,
        None if fault.kind == "squareness" else fault.pose,
        float(np.rad2deg(size)),
        float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(spread)[-1]))),
        float(special.expit(0.5 * (worth[1] - worth[0]))),
        rivals[best][-1].kind if undecided else None,
    )
