"""The uncertainty by samples of the amplitudes against that by a Markov chain."""

import math

import numpy as np
import pytest

from calib.joint.adjust import adjust
from calib.joint.curvature import expected_curvature
from calib.joint.modes import modes_of
from calib.joint.posterior import posterior
from tests.benchmarks.worlds.catalogue import WORLDS
from tests.benchmarks.worlds.knowledge import options_for, views_of

STEPS, KEEPS = 4000, 0.35


@pytest.fixture(scope="module")
def optimum():
    """Three poses of a ray-traced bench with nothing stated: the amplitudes make half of the variance of fx."""
    bench = WORLDS["raytraced"](31, 3, 1, 0)
    return adjust(views_of(bench), options_for(bench, "0"))


@pytest.fixture(scope="module")
def chain(optimum):
    """Step and 1-sigma of fx at the places of a preconditioned Crank-Nicolson chain (Cotter et al., 2013)."""
    rng, base = np.random.default_rng(1), optimum.solution
    low, high = np.array(base.marginal.problem.hyper.bounds).T
    to_eta = np.linalg.inv(np.linalg.cholesky(0.5 * expected_curvature(base))).T
    place, log, solution, steps = np.zeros(len(base.eta)), 0.0, base, []
    for _ in range(STEPS):
        tried = math.sqrt(1.0 - KEEPS**2) * place + KEEPS * rng.standard_normal(len(place))
        eta = base.eta + to_eta @ tried
        if (eta >= low).all() and (eta <= high).all():
            other = base.marginal.solve(eta)
            gain = 0.5 * (base.value - other.value + tried @ tried)
            if math.log(rng.random()) < gain - log:
                place, log, solution = tried, gain, other
        steps.append((solution.step[0], math.sqrt(solution.covariance[0, 0])))
    return np.array(steps).T


@pytest.mark.slow
def test_the_uncertainty_is_that_of_a_markov_chain_over_the_amplitudes(optimum, chain):
    """At the best amplitudes alone it is a third smaller. 25 samples stand for sixty amplitudes: within a fifth."""
    mixture, (steps, sigmas) = posterior(modes_of(optimum)), chain
    by_chain = 2.0 * np.sqrt(steps.var() + (sigmas**2).mean())
    assert mixture.expanded(np.eye(len(mixture.mean))[0]) == pytest.approx(by_chain, rel=0.2)
