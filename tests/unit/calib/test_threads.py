"""Linear algebra of the engine runs on one thread, and leaves a notebook's own as it was."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.one_thread import on_one_thread


def threads():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@pytest.fixture
def two_threads():
    with threadpool_limits(2, user_api="blas"):
        yield threads()


def test_a_function_runs_on_one_thread_and_leaves_the_others_as_they_were(two_threads):
    assert on_one_thread(threads)() == [1] * len(two_threads)
    assert threads() == two_threads


def test_an_error_gives_the_threads_back(two_threads):
    with pytest.raises(ZeroDivisionError):
        on_one_thread(lambda: 1 // 0)()
    assert threads() == two_threads
