"""Settings of a step from the sequence: its own, the defaults, the lens coefficients; and the axes that poses name."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence as List
from typing import Any, Literal, cast

from sequences.schema import (
    AXES,
    Grid,
    PoseConfig,
    Sequence,
    StepConfig,
)
from sequences.solve_schema import DISTORTION_SETS, LENS_FAMILIES, DistortionSet, DistortionTerm
from sequences.strict_model import StrictModel


def axes_named(sequence: Sequence) -> tuple[str, ...]:
    """Return the axes that any pose of the sequence names.

    Returns: The axes in the order pan, tilt, roll.
    """
    named: set[str] = set()
    for poses in sequence.poses.values():
        named.update(_axes_of_set(poses))
    for step in _every_step(sequence.steps):
        if step.move is not None:
            named.update(step.move.angles_deg())
        starts = step.until.start if step.until is not None else None
        for given in (step.repeat.poses if step.repeat is not None else None, starts):
            if given is not None and not isinstance(given, str):
                named.update(_axes_of_set(given))
    return tuple(axis for axis in AXES if axis in named)


def distortion_terms(
    chosen: DistortionSet | tuple[DistortionTerm, ...],
) -> tuple[DistortionTerm, ...] | Literal["auto"]:
    """Return the lens coefficients that a solve step estimates.

    chosen: Name of a set, or coefficients of one lens model in any order.
    Returns: The coefficients in the order of their lens model; ``auto`` if the data are to choose them.

    Examples
    --------
    >>> distortion_terms("k1k2p1p2"), distortion_terms(("k2", "k1")), distortion_terms("none")
    (('k1', 'k2', 'p1', 'p2'), ('k1', 'k2'), ())
    """
    if chosen == "auto":
        return "auto"
    terms = DISTORTION_SETS[chosen] if isinstance(chosen, str) else chosen
    ordered = (term for family in LENS_FAMILIES for term in family if term in terms)
    return cast("tuple[DistortionTerm, ...]", tuple(ordered))


def merged(given: StrictModel, default: StrictModel) -> dict[str, Any]:
    """Return the settings of a step: its own settings, and the defaults for all others.

    default: The sequence's defaults for this kind of step.
    """
    settings = {name: getattr(default, name) for name in type(default).model_fields}
    settings |= {name: getattr(given, name) for name in given.model_fields_set}
    for name, value in settings.items():
        if isinstance(value, StrictModel):
            settings[name] = merged(value, getattr(default, name))
    return settings


def _axes_of_set(poses: list[PoseConfig] | Grid) -> set[str]:
    if isinstance(poses, Grid):
        return set(poses.angles_deg())
    return {axis for pose in poses for axis in pose.angles_deg()}


def _every_step(steps: List[StepConfig]) -> Iterator[StepConfig]:
    for step in steps:
        yield step
        if step.repeat is not None:
            yield from _every_step(step.repeat.steps)
