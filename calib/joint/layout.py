"""Names and places of the shared unknowns of all effects, and what these do to the bases of the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.arrays import Array
from calib.joint.effects import EFFECTS
from calib.joint.effects.by_turn import FollowsPupil, slopes
from calib.joint.effects.effect import Circumstances, Effect, Places, PoseBasis, RandomBlock, Row, Turned
from calib.joint.fields import FieldBasis


class TurnFields(NamedTuple):
    """The coefficients of the Q fields that follow the pupil."""

    rows: Places  # (Q,) places in a pose's basis
    columns: Places  # (Q,) of the shared unknowns
    powers: Places  # (Q, 2) of the turns along X and Y

    def slopes(self, pupils: Array) -> Array:
        """Return (n, 2, Q) derivatives of their factors by the (n, 2) places of the pupils."""
        return slopes(pupils, self.powers)


class OwnCoefficients(NamedTuple):
    """The F coefficients that each pose has for itself."""

    places: Places  # (F,) in its basis
    amplitudes: tuple[str, ...]
    information: Array  # (F,) for unit amplitudes
    rows: tuple[str, ...]  # Of the budget


@dataclass(frozen=True)
class Layout:
    """Names and places of the S shared unknowns."""

    pose: PoseBasis
    bench: Circumstances

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """All effects of this bench."""
        return tuple(effect(self.pose, self.bench) for effect in EFFECTS[self.bench.pupil])

    def with_passport(self, names: Sequence[str]) -> Layout:
        """Return the layout beside a passport that states these names."""
        stated = tuple(name for name in names if name in self.index)
        return replace(self, bench=replace(self.bench, passport=stated))

    @property
    def basis(self) -> FieldBasis:
        """The polynomials of the fields."""
        return self.pose.fields

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all shared unknowns."""
        return tuple(name for effect in self.effects for name in effect.names)

    def names_of(self, kind: type[Effect]) -> tuple[str, ...]:
        """Return the names of the unknowns of one kind of effects; none if the bench has no such effect."""
        return tuple(name for effect in self.effects if isinstance(effect, kind) for name in effect.names)

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Place of each name."""
        return {name: k for k, name in enumerate(self.names)}

    def places(self, names: Sequence[str]) -> Places:
        """Return the places of names."""
        return np.array([self.index[name] for name in names], np.int64)

    def maps(self, poses: Turned) -> Array:
        """Return (n, B, S) what the shared unknowns do to the bases of n poses."""
        maps = np.zeros((len(poses.turns), self.pose.size, len(self.names)))
        ends = np.cumsum([len(effect.names) for effect in self.effects])
        for effect, end in zip(self.effects, ends, strict=True):
            effect.fill(maps[:, :, end - len(effect.names) : end], poses)
        return maps

    @cached_property
    def priors(self) -> tuple[RandomBlock, ...]:
        """What is expected of the unknowns that have amplitudes."""
        return tuple(block for effect in self.effects for block in effect.priors())

    @cached_property
    def rows(self) -> Mapping[str, Row]:
        """The rows of the budget that effects give, by name."""
        rows = [block.row for block in self.priors]
        rows += [part.row for effect in self.effects for part in effect.own()]
        return {row.name: row for row in rows}

    @cached_property
    def own(self) -> OwnCoefficients:
        """What each pose has for itself."""
        parts = [part for effect in self.effects for part in effect.own()]
        return OwnCoefficients(
            np.concatenate([part.places for part in parts]),
            tuple(name for part in parts for name in part.amplitudes),
            np.concatenate([part.information for part in parts]),
            tuple(part.row.name for part in parts for _ in part.amplitudes),
        )

    @cached_property
    def by_turn(self) -> TurnFields:
        """The fields that follow the pupil."""
        fields = [effect for effect in self.effects if isinstance(effect, FollowsPupil)]
        return TurnFields(
            np.concatenate([field.rows for field in fields]),
            self.places([name for field in fields for name in field.names]),
            np.concatenate([field.powers for field in fields]),
        )
