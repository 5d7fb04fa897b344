"""Cases of a parametrized test of which some are always run, and the others by `make test-slow`."""

import pytest


def first_quick(cases, count=1):
    """The cases, all but the first ``count`` of them marked as slow."""
    return [case if place < count else _slow(case) for place, case in enumerate(cases)]


def _slow(case):
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
