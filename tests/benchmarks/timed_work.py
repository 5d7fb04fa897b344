"""Work of `bench_cluster` that tells when it was done; workers import it."""

import os
import time

from bench.work.places import Place
from bench.work.tasks import Task, find_view


def timed_find(place: Place, number: int, capture: str, task: Task) -> tuple[int, float, float, float]:
    """Find the stars of a recording; return the process, begin and end on the monotonic clock, and its CPU time, s."""
    begun, cpu_s = time.monotonic(), time.process_time()
    find_view(place, number, capture, task)
    return os.getpid(), begun, time.monotonic(), time.process_time() - cpu_s
