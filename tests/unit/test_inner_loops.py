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


def test_a_call_from_python_is_found_by_its_own_name_and_by_its_modules(tmp_path, inner):
    program = tmp_path / "program.py"
    program.write_text(
        "from simulators.pixels import square_light as tail\n"
        "from simulators.pixels.pixel_reset import reset_row as again\n"
        "@njit(**LOOP)\ndef loop(x):\n    return tail.level(x)\n"
        "def plain(x):\n    return tail.level(x) + again(x) + loop(x)\n"
    )
    assert list(calls_from_python(program, inner)) == ["program.py:7: tail.level", "program.py:7: again"]
