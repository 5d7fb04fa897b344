"""Functions compiled without an entry for Python are called by compiled functions only: another call would crash."""

import pytest

from tests.support.inner_loops import ROOT, calls_from_python, inner_functions

PACKAGES = ("simulators", "drivers", "calib")


@pytest.fixture(scope="module")
def inner():
    return inner_functions(sorted(path for name in PACKAGES for path in (ROOT / name).rglob("*.py")))


def test_python_calls_no_function_that_only_loops_may_call(inner):
    everything = sorted(
        path for name in (*PACKAGES, "bench", "tests") for path in (ROOT / name).rglob("*.py")
    )
    assert len(inner) > 50
    assert [call for path in everything for call in calls_from_python(path, inner)] == []
