"""What may be otherwise than stated: other 1-sigmas of some unknowns, with odds beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from calib.arrays import Array

from .table import Statement, Unknowns

#: Faults of a statement: as if nobody had stated it; no fault: it states a focal length.
WRONG, FOCAL = "wrong", "focal length"
#: Errors may be so many times as large as stated, or more: the first step of a ladder. By each further such factor the
#: odds fall as one over the width, as the tails of published measurements do (Bailey, 2017).
_WIDER = 10.0**0.5
#: Odds that a statement is about another thing, however precise it is: a label may be of another sheet.
_ANOTHER = 1e-3
#: A certificate that does not say so states the focal length: makers state the one, benches measure the other.
_OTHER_LENGTH = 1.0


@dataclass(frozen=True)
class Hypothesis:
    """A combination of faults of statements."""

    faults: tuple[tuple[str, str], ...] = ()  # Names of statements and their faults
    log_odds: float = field(default=0.0, compare=False)  # Against all as stated
    wide: dict[int, float] = field(default_factory=dict, compare=False)  # Other 1-sigmas, by places

    def beside(self, other: Hypothesis) -> Hypothesis | None:
        """Return both together; None if they are about the same statement."""
        mine, more = dict(self.faults), dict(other.faults)
        if mine.keys() & more.keys():
            return None
        faults = tuple(sorted((mine | more).items()))
        return Hypothesis(faults, self.log_odds + other.log_odds, self.wide | other.wide)


AS_IT_STANDS = Hypothesis()


def hypotheses(unknowns: Unknowns) -> list[Hypothesis]:
    """Return what each statement can be beside what it says; and all of one source together."""
    found: list[Hypothesis] = []
    statements = [statement for statement in unknowns.statements if (statement.free > 0.0).all()]
    for statement in statements:
        found += _ladder((statement,), unknowns.size)
        if statement.focal is not None:
            wide = {int(statement.at[0]): statement.focal}
            found.append(Hypothesis(((statement.name, FOCAL),), math.log(_OTHER_LENGTH), wide))
    ordered = sorted(statements, key=lambda statement: statement.together)
    for source, members in groupby(ordered, key=lambda statement: statement.together):
        together = tuple(members)
        if source and len(together) > 1:
            found += _ladder(together, unknowns.size, math.log(together[0].together_odds))
    return found


def _ladder(statements: tuple[Statement, ...], size: Array, more: float = 0.0) -> list[Hypothesis]:
    """Return statements with ever larger errors, up to those that nobody states; ``more``: logarithm of a factor."""
    first = statements[0]
    own = size[first.at] if first.larger is None else first.larger
    widest = float((np.maximum(first.free, own) / own).max())
    ladder, left, times = list[Hypothesis](), first.odds, _WIDER

    def one(fault: str, odds: float, times: float | None) -> Hypothesis:
        wide: dict[int, float] = {}
        for statement in statements:
            grown = size[statement.at] if statement.larger is None else statement.larger
            sigma = np.maximum(statement.free, size[statement.at])
            if times is not None:
                sigma = np.sqrt(size[statement.at] ** 2 + (times**2 - 1.0) * grown**2)
            wide |= dict(zip(statement.at.tolist(), sigma.tolist(), strict=True))
        return Hypothesis(tuple((s.name, fault) for s in statements), math.log(odds) + more, wide)

    while times * _WIDER**0.5 < widest:
        ladder.append(one(f"{times:.3g} times", left * (1.0 - 1.0 / _WIDER), times))
        left, times = left / _WIDER, times * _WIDER
    ladder.append(one(WRONG, max(left, _ANOTHER), None))
    return ladder
