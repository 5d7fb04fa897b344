"""Cases of a parametrized test of which some are always run, and the others by `make test-slow`."""

import pytest


def first_quick(cases, count=1):
    """The cases, all but the first ``count`` of them marked as slow."""
    quick, others = list(cases)[:count], list(cases)[count:]
    return [*quick, *(slow(*case) if isinstance(case, tuple) else slow(case) for case in others)]


def slow(*case, **named):
    """A case that is marked as slow; ``id`` may name it."""
    return pytest.param(*case, marks=pytest.mark.slow, **named)
