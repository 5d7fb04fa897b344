"""The posterior: a mixture over the amplitudes, over faults of statements, and over what else explains the views.

For given amplitudes the posterior is Gaussian (`calib.joint.marginal`). The amplitudes are known only so well, so the
result is the mixture over their posterior: importance sampling about each mode, with fixed normal deviates, so that the
result follows the data without steps. A statement may be doubted (`calib.joint.doubts`): each doubt has odds
beforehand, and counts by its likelihood. If two statements contradict each other and nothing decides, the mixture
covers both. Other explanations (`calib.joint.hypotheses`) join it with their shares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import Array
from calib.errors import NotConverged
from calib.joint.doubts import Innovation, innovations
from calib.joint.effects.collimator import CENTRE, RADIAL
from calib.joint.effects.effect import Places
from calib.joint.effects.gimbal import GimbalErrors
from calib.joint.evidence import odds_of
from calib.joint.hypotheses import Hypothesis
from calib.joint.modes import Modes, modes_of
from calib.joint.places import spread_of_places
from calib.joint.samples import Node, nodes_about
from calib.joint.solve import TRUSTED, Optimum, optimum_with_faults, relative_step

#: A mode of a smaller share stands for all amplitudes about it.
_SMALL_SHARE = 0.1
#: A fault that leads farther is looked at if its odds against none are more than this.
_COUNTS = 0.05


@dataclass(frozen=True)
class Other:
    """The posterior by another explanation of the same views, in the unknowns of the first one."""

    posterior: Posterior
    share: float
    hypothesis: Hypothesis
    names: tuple[str, ...]  # The results that both have
    follow: Array  # (S, C) how all unknowns of the first follow these
    rest: Array  # (S, S) covariance of what does not follow them
    means: Array  # (L, S) of its nodes

    @cached_property
    def covariances(self) -> list[Array]:
        """(S, S) of each node."""
        at = self.posterior.optimum.marginal.problem.bench.layout.places(self.names)
        return [
            self.follow @ covariance[np.ix_(at, at)] @ self.follow.T + self.rest
            for covariance in self.posterior.covariances
        ]

    def gradients(self, gradients: Array) -> Array:
        """Return (p, S') in its own unknowns the (p, S) gradients of results in those of the first."""
        layout = self.posterior.optimum.marginal.problem.bench.layout
        own = np.zeros((len(gradients), len(layout.names)))
        own[:, layout.places(self.names)] = gradients @ self.follow
        return own


@dataclass(frozen=True)
class Posterior:
    """The mixture."""

    modes: Modes
    nodes: tuple[Node, ...]
    spread: Array  # (A,) 1-sigma of the logarithms of the amplitudes
    faults: dict[str, float]  # Probability of a fault by name of the statement
    largest: Node  # The mode with the largest share
    others: tuple[Other, ...] = ()
    denied: Innovation | None = None  # A statement that is not in the equations: it is probably wrong
    # (S,) how far the shared unknowns of a pose may be from the stated ones, all together; even up to there. None: as
    # far as the covariance says.
    unsteady: Array | None = None
    better_lens: str = ""  # Coefficients of the other family of lenses, if it explains the views far better

    @property
    def optimum(self) -> Optimum:
        """The optimum of the first explanation."""
        return self.modes.optimum

    @property
    def reported(self) -> Optimum:
        """The optimum of which residuals and rotations are reported: a statement that is doubted pulls none of them."""
        return replace(self.optimum, solution=self.largest.solution) if self.largest.faults else self.optimum

    @property
    def share(self) -> float:
        """Probability of the first explanation."""
        return 1.0 - sum(other.share for other in self.others)

    @property
    def explanations(self) -> list[tuple[Posterior, float, Hypothesis | None]]:
        """Each explanation alone, with its share; None is the hypothesis of the first."""
        others = [(other.posterior, other.share, other.hypothesis) for other in self.others]
        return [(replace(self, others=()), self.share, None), *others]

    @cached_property
    def weights(self) -> Array:
        """(K,) weights of the nodes, those of other explanations behind."""
        own = np.array([node.weight for node in self.nodes])
        return np.concatenate(
            [self.share * own, *(other.share * other.posterior.weights for other in self.others)]
        )

    @cached_property
    def means(self) -> Array:
        """(K, S) means of the shared unknowns."""
        own = self.optimum.state.shared + np.array([node.solution.step for node in self.nodes])
        return np.concatenate([own, *(other.means for other in self.others)])

    @cached_property
    def covariances(self) -> list[Array]:
        """(S, S) of each node."""
        own = [node.solution.covariance for node in self.nodes]
        if self.pupils is not None:
            own = [covariance + self.pupils for covariance in own]
        return own + [covariance for other in self.others for covariance in other.covariances]

    @cached_property
    def pupils(self) -> Array | None:
        """(S, S) covariance that the places of the pupil add; None on a gimbal."""
        moved = self.optimum.marginal.problem.pupils is not None
        return spread_of_places(self.optimum.solution) if moved else None

    @cached_property
    def mean(self) -> Array:
        """(S,) mean of the shared unknowns."""
        return np.asarray(self.weights @ self.means)

    @cached_property
    def covariance(self) -> Array:
        """(S, S) covariance of the shared unknowns."""
        from_mean = self.means - self.mean
        within = sum(weight * own for weight, own in zip(self.weights, self.covariances, strict=True))
        covariance = within + (self.weights[:, None] * from_mean).T @ from_mean
        if self.unsteady is not None:
            covariance = covariance + np.outer(self.unsteady, self.unsteady) / 3.0
        return np.asarray(covariance)

    def expanded(self, row: Array) -> float:
        """Return U of the function with the (S,) gradient row: 2 u, and beyond as far as the focal lengths of poses.

        An interval of 95.45 % jumps where the probability of a second camera passes 4.55 %.
        """
        beyond = 0.0 if self.unsteady is None else abs(float(row @ self.unsteady))
        return 2.0 * math.sqrt(float(row @ self.covariance @ row) - beyond**2 / 3.0) + beyond

    def share_of(self, fault: tuple[str, str]) -> float:
        """Return the probability of a fault of a statement, or of its other meaning."""
        own = self.share * sum(node.weight for node in self.nodes if fault in node.faults)
        return own + sum(other.share * other.posterior.share_of(fault) for other in self.others)

    def innovations(self) -> list[Innovation]:
        """Return the innovation of every statement that could be wrong, at the largest mode."""
        found = innovations(self.largest.solution, 2.0 * self.modes.curvature)
        found += [self.denied] if self.denied else []
        return [
            replace(innovation, probability=self.faults.get(innovation.name, 0.0)) for innovation in found
        ]


def posterior(modes: Modes, *, follow: bool = True) -> Posterior:
    """Return the posterior by the modes about an optimum, or about the most probable faults if these lead far from it.

    The equations at the state that such faults lead to say how much they count. They do not count if these equations
    lead far away again, or if ``follow`` is false. The equations of a fault's state say nothing of what is far away.
    """
    optimum, nodes = modes.optimum, modes.nodes
    if optimum.fault_eta is not None and (held := [node for node in nodes if _holds(optimum, node)]):
        return _mixture(modes, held)
    undoubted = max((node for node in nodes if not node.faults), key=_weight)
    begins = (0.0, undoubted.solution.step)  # doubts hold where their amplitudes do without doubts
    far = [node for node in nodes if node.faults and not any(_holds(optimum, node, at) for at in begins)]
    near = [node for node in nodes if not any(node is other for other in far)]
    likeliest = max(far, key=_weight, default=None)
    if likeliest is None or likeliest.weight < _COUNTS * undoubted.weight:
        return _mixture(modes, nodes)
    if not follow:
        return _mixture(modes, near)
    try:
        there = optimum_with_faults(optimum, likeliest.faults)
        odds = odds_of(there, likeliest.faults, replace(optimum, solution=undoubted.solution))
    except (NotConverged, np.linalg.LinAlgError):  # without the statement nothing determines the camera
        return _mixture(modes, near)
    if odds > 1.0 and likeliest.weight > max(node.weight for node in near):
        modes_there = modes_of(there)
        near_there = [node for node in modes_there.nodes if _holds(there, node)]
        if near_there:
            return _mixture(modes_there, near_there)
        odds = 0.0
    share = min(odds * undoubted.weight / likeliest.weight, 1.0)
    lowered = [replace(node, weight=share * node.weight) for node in far]
    return _mixture(modes, [*near, *lowered])


def _holds(optimum: Optimum, mode: Node, begin: Array | float = 0.0) -> bool:
    """Return whether the step to a mode, from the end ``begin`` (S,) of another one, leaves the equations valid."""
    return relative_step(optimum.marginal, mode.solution.step - begin) < TRUSTED


def _weight(mode: Node) -> float:
    return mode.weight


def _mixture(modes: Modes, nodes: Sequence[Node]) -> Posterior:
    """Return the mixture of some of the modes, or of others."""
    lower: Array = np.asarray(np.linalg.cholesky(modes.curvature), np.float64)
    whole = sum(mode.weight for mode in nodes)
    samples: list[Node] = []
    for mode in nodes:
        share = mode.weight / whole
        if share < _SMALL_SHARE:
            samples.append(replace(mode, weight=share))
        else:
            samples += nodes_about(mode, lower, share)
    spread = np.sqrt(np.diag(np.linalg.inv(modes.curvature)))
    return Posterior(modes, tuple(samples), spread, modes.fault_probabilities(nodes), max(nodes, key=_weight))


def mixed(first: Posterior, others: Sequence[tuple[Posterior, float, Hypothesis]]) -> Posterior:
    """Return a posterior as the mixture with those of other explanations, each with its share and hypothesis.

    Unknowns that are not results are those of the first, and follow the results as in it.
    """
    members = [(first, 1.0 - sum(share for _, share, _ in others), None), *others]
    faults = dict.fromkeys((name for member, _, _ in members for name in member.faults), 0.0)
    for member, share, _ in members:
        for name, probability in member.faults.items():
            faults[name] += share * probability
    alone, *rest = [
        (part, share * own, of_part or hypothesis)
        for member, share, hypothesis in members
        for part, own, of_part in member.explanations
    ]
    named = [(part, share, hypothesis) for part, share, hypothesis in rest if hypothesis]
    return replace(first, faults=faults, others=tuple(_as_other(alone[0], *part) for part in named))


def _as_other(first: Posterior, other: Posterior, share: float, hypothesis: Hypothesis) -> Other:
    """Return the posterior of another explanation in the unknowns of the first."""
    layout, there = (member.optimum.marginal.problem.bench.layout for member in (first, other))
    results = (*layout.pose.camera, *CENTRE, *RADIAL, *layout.names_of(GimbalErrors))
    names = tuple(name for name in results if name in there.index)
    at = layout.places(names)
    solution = first.largest.solution
    follow = _follow(solution.covariance, at)
    rest = solution.covariance - follow @ solution.covariance[at]
    middle = first.optimum.state.shared + solution.step
    means = middle + (other.means[:, there.places(names)] - middle[at]) @ follow.T
    return Other(other, share, hypothesis, names, follow, rest, means)


def _follow(covariance: Array, at: Places) -> Array:
    """Return (S, C) how all unknowns follow the C at some places, for an (S, S) covariance."""
    scale = np.sqrt(np.diag(covariance))
    alike = covariance / np.outer(scale, scale)
    follow = np.linalg.solve(alike[np.ix_(at, at)], alike[at]).T
    follow[at] = np.eye(len(at))
    return np.asarray(scale[:, None] * follow / scale[at])
