"""Docstrings of public callables leave nothing out: parameters, results, exceptions raised, shapes of arrays."""

import ast

import docstring_sample as sample
import pytest


def gaps(source):
    (node,) = ast.parse(source).body
    return list(sample.PublicCallable("here", node.name, node, ast.get_docstring(node) or "").gaps())


@pytest.mark.parametrize("package", sample.PACKAGES)
def test_no_public_callable_leaves_anything_out(package):
    found = sample.public_callables([package])
    assert found
    assert [f"{one.place}: {one.name}: {gap}" for one in found for gap in one.gaps()] == []


def test_the_check_sees_what_is_left_out():
    source = '''
def fit(points: Array, weights: Array | None, /, *, loss: str) -> Array:
    """Fit.

    Parameters
    ----------
    points
        Image points, px.
    loss
        Name of the loss.
    """
    raise ValueError("no")
'''
    assert gaps(source) == [
        "parameter points has no shape",
        "parameter weights is not described",
        "no Returns section",
        "ValueError is raised and not listed",
    ]


def test_the_check_passes_what_is_complete():
    source = '''
def fit(points: Array, weights: Array | None, /, *, loss: str) -> Array:
    """Fit.

    Parameters
    ----------
    points, weights
        (N, 2) image points, px, and (N,) weights.
    loss
        Name of the loss.

    Returns
    -------
    Array
        (3, 3) homography.

    Raises
    ------
    ValueError
        Always.
    """
    raise ValueError("no")
'''
    assert gaps(source) == []
