"""The one evidence: how probable the views are by an optimum, with the weights that the stars have at another.

Only with the same weights can two be compared: where stars fit badly, they would not count.
"""

from __future__ import annotations

from .equations import Equations
from .posterior import Posterior
from .search import Optimum, best_amplitudes
from .solution import solve


def value_as_weighed(there: Optimum, than: Optimum) -> float:
    """Return -2 log of the likelihood of an optimum with the star weights of another, at the best amplitudes then."""
    if there is than:
        return there.solution.value
    q = Equations.at(there.solution.problem, there.state, than.solution.equations.weights)
    return best_amplitudes(solve(q, there.solution.eta, there.solution.wide)).value


def log_ratio(there: Posterior, first: Posterior) -> float:
    """Return the logarithm of how much more probable the views are by a posterior than by the first, over hypotheses.

    With the weights of either: each explains its own stars best.
    """
    a, b = there.optimum, first.optimum
    with_own = value_as_weighed(b, a) - a.solution.value
    with_others = b.solution.value - value_as_weighed(a, b)
    return there.log_odds - first.log_odds + 0.25 * (with_own + with_others)
