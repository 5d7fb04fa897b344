"""Centres by symmetry: the quick test of the normal equations."""

import numpy as np

from calib.stars.centring import _clearly_regular


def test_a_matrix_that_is_clearly_regular_has_a_small_condition():
    """The quick test may only spare the exact one, never contradict it."""
    random = np.random.default_rng(3)
    verdicts = []
    for exponent in np.linspace(0.0, 14.0, 60):
        q, _ = np.linalg.qr(random.normal(size=(6, 6)))
        matrix = q @ np.diag(np.logspace(0.0, -exponent, 6)) @ q.T
        scale = np.sqrt(np.diag(matrix))
        scaled = matrix / scale[:, None] / scale[None, :]
        verdicts.append(_clearly_regular(scaled))
        if verdicts[-1]:
            assert np.linalg.cond(scaled) < 1e10
    assert verdicts[0]
    assert not verdicts[-1]
    assert not _clearly_regular(np.ones((6, 6)))
