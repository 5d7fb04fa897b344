"""Which statements hold: a mixture over what each can be, weighed by the views.

Each statement has heavy tails: it holds, or its errors are larger, by a ladder of widths with falling odds
(`Statement.doubts`). For given amplitudes all is linear in what is stated. So the posterior in which nobody had stated
anything, seen through the T values of all statements, gives the evidence of any combination by T x T matrices
(`Unstated`), and only combinations that count are solved in full.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.curvature import ROUGH, best_amplitudes
from calib.joint.hypotheses import WHOLE_GIMBAL, WHOLE_PASSPORT
from calib.joint.knowledge import CERTIFICATE, FOCAL, WRONG, Statement
from calib.joint.marginal import Marginal, Solution
from calib.joint.places import spread_by_fields
from calib.joint.prior import NO_FAULT, Faults, block_diagonal
from calib.joint.samples import Node, trusted
from calib.joint.solve import Optimum
from calib.model.result_parts import GIMBAL_SCALE, PASSPORT

#: What one source states can be wrong together, with this share of the odds of a single doubt.
_TOGETHER = {GIMBAL_SCALE: WHOLE_GIMBAL.odds, PASSPORT: WHOLE_PASSPORT.odds}
#: A combination stands beside another one as far as this logarithm below the likeliest.
_BESIDE = 2.0
#: The best amplitudes of doubts are searched if a statement is away from the others by more sigmas than the first, and
#: if their likelihood may reach that of no doubt within the second as a logarithm; for so many sets of statements.
_AGREES, _FOLLOWED, _SEARCHES = 1.5, 2.0, 4
#: Doubts are as none if their probability times the change of the camera, in sigmas or as a share of a sigma, is less:
#: U then lacks less than 1 %.
_ALIKE = 5e-3
#: No evidence is larger than this logarithm, so that odds stay numbers.
LARGEST_LOG = 100.0


@dataclass(frozen=True)
class Innovation:
    """What a statement says against what all others say."""

    name: str
    statement: Statement
    expected: Array  # (k,) by all others
    sigma: Array  # (k,) of that
    normalised: float  # Stated minus expected over its sigma; root mean square for a joint statement
    probability: float = 0.0  # That the statement is at fault


class Unstated:
    """The posterior for given amplitudes as if nobody had stated anything, seen through the T values of all statements.

    What is stated is then added. That needs no difference of nearly equal numbers.
    """

    def __init__(self, marginal: Marginal, eta: Array) -> None:
        self.eta, self.witnesses = eta, marginal.problem.knowledge.witnesses
        solution = marginal.solve(eta, tuple((name, WRONG) for name in self.witnesses))
        statements = list(self.witnesses.values())
        rows = np.concatenate([statement.rows for statement in statements])
        values = np.concatenate([statement.values for statement in statements])
        self._root = solution.root @ rows.T
        mean = marginal.state.shared + solution.step
        self.covariance, self.away = self._root.T @ self._root, values - rows @ mean
        camera = slice(0, len(marginal.problem.bench.layout.pose.camera))
        self._value, self._camera, self._mean = solution.value, solution.root[:, camera], mean[camera]
        self._values: dict[Faults, float] = {}
        self._logarithms = {
            name: {
                doubt: float(np.linalg.slogdet(witness.information(doubt))[1])
                for doubt in ("", *witness.doubts)
            }
            for name, witness in self.witnesses.items()
        }

    def more(self, doubts: Faults) -> list[Array]:
        """Return by how much the information of each statement is larger than if nobody had stated it."""
        named = dict(doubts)
        return [
            witness.information(named.get(witness.name, "")) - witness.information(WRONG)
            for witness in self.witnesses.values()
        ]

    def value(self, doubts: Faults) -> float:
        """Return -2 log of the likelihood, as `Solution.value`, if some statements are doubted."""
        if doubts not in self._values:
            self._values[doubts] = self._value_of(doubts)
        return self._values[doubts]

    def _value_of(self, doubts: Faults) -> float:
        named, more = dict(doubts), block_diagonal(self.more(doubts))
        inside = np.eye(len(more)) + self.covariance @ more
        value = self._value + float(self.away @ more @ np.linalg.solve(inside, self.away))
        value += float(np.linalg.slogdet(inside)[1])
        return value - sum(own[named.get(name, "")] - own[WRONG] for name, own in self._logarithms.items())

    def camera(self, doubts: Faults) -> tuple[Array, Array]:
        """Return the camera's values and their 1-sigma."""
        more, across = block_diagonal(self.more(doubts)), self._camera.T @ self._root
        right = np.column_stack([across.T, self.away])
        gain = more @ np.linalg.solve(np.eye(len(more)) + self.covariance @ more, right)
        variances = (self._camera**2).sum(axis=0) - (across.T * gain[:, :-1]).sum(axis=0)
        return self._mean + across @ gain[:, -1], np.sqrt(variances)

    def innovations(self, doubts: Faults) -> list[Innovation]:
        """Compare each statement with what all others say, and what would be known if nobody had stated it."""
        named, more = dict(doubts), self.more(doubts)
        answer, end = [], 0
        for k, witness in enumerate(self.witnesses.values()):
            statement = witness.as_meant(named.get(witness.name, ""))
            own = slice(end, end := end + len(statement.values))
            others = block_diagonal([*more[:k], np.zeros_like(more[k]), *more[k + 1 :]])
            right = np.column_stack([self.covariance, self.away])
            follow = np.linalg.solve(np.eye(len(right)) + self.covariance @ others, right)
            spread, off = follow[own, own], follow[own, -1]
            z = float(np.sqrt(off @ np.linalg.solve(statement.covariance + spread, off) / len(off)))
            z *= float(np.sign(off[0])) if len(off) == 1 else 1.0
            answer.append(
                Innovation(statement.name, statement, statement.values - off, np.sqrt(np.diag(spread)), z)
            )
        return answer


def innovations(solution: Solution, curvature: Array) -> list[Innovation]:
    """Compare each statement with what all others say; a certificate at the amplitudes that are best without it.

    A wrong one makes the errors of the collimator look large, and is then hardly contradicted. The (A, A) curvature is
    that at the solution. A search for every statement would double the time of a fit.
    """
    marginal = solution.marginal
    answer = Unstated(marginal, solution.eta).innovations(solution.faults)
    for at, name in enumerate(marginal.problem.knowledge.witnesses):
        if name == CERTIFICATE:
            without = tuple(sorted((dict(solution.faults) | {name: WRONG}).items()))
            alone = marginal.solve(solution.eta, without)
            best = best_amplitudes(alone, enough=ROUGH, curvature=curvature)
            answer[at] = Unstated(marginal, best.eta).innovations(solution.faults)[at]
    return answer


@dataclass(frozen=True)
class Doubted:
    """The combinations of doubts beside none, with odds against it; all odds are divided by a common ``scale``."""

    nodes: list[Node]  # Those that show another camera
    likeliest: Faults  # The likeliest combination, which may be none
    alike: dict[Faults, float]  # Odds of those that show the same camera as the likeliest
    scale: float  # Logarithm


def prior_odds(witnesses: Mapping[str, Statement], doubts: Faults) -> float:
    """Return the prior odds of doubts against no doubt; a source can be wrong in all that it states."""
    alone = {name: witnesses[name].doubts[doubt].odds for name, doubt in doubts}
    odds = math.prod(alone.values())
    for group, share in _TOGETHER.items():
        own = [name for name, witness in witnesses.items() if witness.group == group]
        if len(own) > 1 and {*own} <= {*alone} and len({doubt for name, doubt in doubts if name in own}) == 1:
            others = math.prod(of_name for name, of_name in alone.items() if name not in own)
            odds += others * share * alone[own[0]]
    return odds


class _Search:
    """The search for the combinations that count, at ever better amplitudes."""

    def __init__(self, optimum: Optimum, curvature: Array, others: Sequence[Array]) -> None:
        self.optimum, self.curvature = optimum, curvature
        self.witnesses = optimum.marginal.problem.knowledge.witnesses
        self.at: list[Unstated] = []
        for eta in (optimum.eta, usual_amplitudes(optimum), optimum.fault_eta, *others):
            with suppress(np.linalg.LinAlgError):  # amplitudes that do not determine all unknowns
                self.at += [] if eta is None else [Unstated(optimum.marginal, eta)]

    def best(self, doubts: Faults) -> tuple[float, Unstated]:
        """Return -2 log of the likelihood of doubts, and at which amplitudes it is the largest."""
        return min(((at.value(doubts), at) for at in self.at), key=lambda value: value[0])

    def log_odds(self, doubts: Faults) -> float:
        """Return the logarithm of the odds of doubts against none."""
        prior = math.log(prior_odds(self.witnesses, doubts))
        return 0.5 * (self.best(NO_FAULT)[0] - self.best(doubts)[0]) + prior

    def contradicted(self) -> set[str]:
        """Return the statements that some of the others contradict, and those with another meaning."""
        innovations = (innovation for at in self.at for innovation in at.innovations(NO_FAULT))
        contradicted = {innovation.name for innovation in innovations if abs(innovation.normalised) > _AGREES}
        return contradicted | {name for name, witness in self.witnesses.items() if FOCAL in witness.doubts}

    def improve(self, doubts: Faults) -> None:
        """Search the best amplitudes of doubts, if these may make them count."""
        marginal, optimum = self.optimum.marginal, self.optimum
        start = marginal.solve(self.best(doubts)[1].eta, doubts)
        gain = 0.25 * float(start.gradient @ np.linalg.solve(self.curvature, start.gradient))
        if 0.5 * (self.best(NO_FAULT)[0] - start.value) + gain > -_FOLLOWED:
            known = 2.0 * self.curvature if start.eta is optimum.eta else None
            ended = best_amplitudes(start, enough=ROUGH, curvature=known)
            self.at.append(Unstated(marginal, ended.eta))

    def combinations(self) -> dict[Faults, float]:
        """Return combinations of doubts with the logarithms of their odds: beside none, and beside those that count."""
        combinations: dict[Faults, float] = {NO_FAULT: 0.0}
        open_ones = [NO_FAULT]
        while open_ones:
            for doubts in self._beside(open_ones.pop()):
                if doubts not in combinations:
                    combinations[doubts] = self.log_odds(doubts)
                    if combinations[doubts] > max(combinations.values()) - _BESIDE:
                        open_ones.append(doubts)
        del combinations[NO_FAULT]
        return combinations

    def _beside(self, doubts: Faults) -> Iterator[Faults]:
        """Give the combinations that doubt one more statement, or all of one source."""
        named = dict(doubts)
        sources = [
            [name for name, witness in self.witnesses.items() if witness.group == group]
            for group in _TOGETHER
        ]
        for names in [*([name] for name in self.witnesses), *(own for own in sources if len(own) > 1)]:
            if not named.keys() & set(names):
                for doubt in self.witnesses[names[0]].doubts:
                    more = {name: doubt for name in names if doubt in self.witnesses[name].doubts}
                    yield tuple(sorted((named | more).items()))


def doubted(optimum: Optimum, curvature: Array, others: Sequence[Node] = ()) -> Doubted:
    """Return the doubts beside an optimum, which has the (A, A) curvature, and beside its other modes.

    A wrong statement makes the errors of the collimator look large, and then hardly contradicts the others. So the
    evidence counts at the best of several amplitudes: those of the optimum and of its other modes, expected ones, and
    those that fit the most probable doubts best.
    """
    search = _Search(optimum, curvature, [combination.eta for combination in others])
    odds, possible, done = search.combinations(), search.contradicted(), set[tuple[str, ...]]()
    for _ in range(_SEARCHES):
        left = [
            combination
            for combination in odds
            if _names(combination) not in done and {*_names(combination)} <= possible
        ]
        if not left:
            break
        likeliest = max(left, key=lambda combination: odds[combination])
        done.add(_names(likeliest))
        for doubts in dict.fromkeys((likeliest, tuple((name, WRONG) for name in _names(likeliest)))):
            search.improve(doubts)
        odds = search.combinations()
    best = search.best(NO_FAULT)[1].eta
    of_mode = max((combination.weight for combination in others if combination.eta is best), default=1.0)
    return _chosen(search, odds, math.log(of_mode))


def _names(doubts: Faults) -> tuple[str, ...]:
    """Return the names of doubted statements."""
    return tuple(name for name, _ in doubts)


def _chosen(search: _Search, odds: dict[Faults, float], log_mode: float) -> Doubted:
    """Return the combinations that count, solved in full where they show another camera than the likeliest.

    ``log_mode`` is the logarithm of the odds of the best mode without doubts against the optimum: odds are against it.
    """
    optimum, alike = search.optimum, dict[Faults, float]()
    solutions: list[tuple[Solution, float]] = []
    likeliest = max(odds, key=lambda doubts: odds[doubts], default=NO_FAULT)
    likeliest = likeliest if odds.get(likeliest, 0.0) > 0.0 else NO_FAULT
    first = search.at[0] if likeliest == NO_FAULT else search.best(likeliest)[1]
    value, sigma = first.camera(likeliest)
    whole = float(np.logaddexp.reduce([0.0, *odds.values()]))
    for doubts, log in odds.items():
        share, at = math.exp(log - whole), search.best(doubts)[1]
        if share < _ALIKE**2:
            continue
        there, wide = at.camera(doubts)
        change = max(np.abs(wide / sigma - 1.0).max(), np.abs((there - value) / sigma).max())
        if doubts != likeliest and share * float(change) < _ALIKE:
            alike[doubts] = log - odds.get(likeliest, 0.0)
            continue
        solution = optimum.marginal.solve(at.eta, doubts)
        prior = math.log(prior_odds(search.witnesses, doubts))
        evidence = (log - prior) * share_of_stars(solution) + math.log(trusted(solution, optimum.solution))
        solutions.append((solution, prior + evidence + log_mode))
    own = next((log for solution, log in solutions if solution.faults == likeliest), log_mode)
    scale = max([0.0, own, *(log for _, log in solutions)])
    nodes = [Node(solution, math.exp(log - scale)) for solution, log in solutions]
    same = {doubts: math.exp(own + log - scale) for doubts, log in alike.items()}
    return Doubted(nodes, likeliest, same, scale)


def share_of_stars(solution: Solution) -> float:
    """Return the share of evidence against statements that counts: places of pupils may be the cause of the rest."""
    problem = solution.marginal.problem
    if problem.pupils is None:
        return 1.0
    places, witnesses = spread_by_fields(solution), problem.knowledge.witnesses
    rows = np.concatenate([witnesses[name].rows for name, _ in solution.faults])
    stars, discs = (float(((rows @ covariance) * rows).sum()) for covariance in (solution.covariance, places))
    return stars / (stars + discs)


def usual_amplitudes(optimum: Optimum) -> Array:
    """Return the amplitudes with those of the collimator as they are expected."""
    hyper = optimum.marginal.problem.hyper
    kept = hyper.places((amp.STAR, amp.READING, *amp.POSE))
    eta = hyper.mean.copy()
    eta[kept] = optimum.eta[kept]
    return eta
