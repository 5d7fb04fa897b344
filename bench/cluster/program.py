"""Refuses work of another program. Loads no mathematics."""

from __future__ import annotations

from bench.base.errors import BenchError
from bench.results.forms import forms


def require_program_of(program: str) -> None:
    """Refuse work of another program, because its results would differ.

    program: Hash of the program that hands out the work.
    Raises BenchError: If this worker runs another program.
    """
    if (here := forms()["program"]) != program:
        raise BenchError(
            f"This worker has another Starbench ({here}) than the command ({program}).",
            remedy="Install the same version on all computers, and restart the workers.",
        )
