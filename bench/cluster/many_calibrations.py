"""Studies by many workers: blocks of simulated calibrations, each kept on the disk as soon as it is done."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from dataclasses import asdict

from bench.cluster.kept_rows import KeptRows, content_key
from bench.cluster.program import require_program_of
from bench.cluster.work import Workers, results_of
from bench.results.forms import forms
from bench.results.studies import PlannedStudy
from calib.studies.monte_carlo import MonteCarloStudy, Repetition, study_of

STUDY = "study.jsonl"
BLOCK = 16
"""Calibrations of one piece of work. Their numbers decide the noise, so the result does not depend on the blocks."""


def run_blocks(
    planned: PlannedStudy,
    runs: int,
    workers: Workers,
    kept: KeptRows | None = None,
    done: Callable[[int], None] = lambda _more: None,
) -> MonteCarloStudy:
    """Run a study.

    kept: Blocks on the disk: those of an earlier command are used, new ones are kept; None for neither.
    Raises WorkersLost: If nobody is left who could do the work.
    Raises BenchError: If a worker runs another program.
    Raises StorageError: If a block cannot be kept.
    Raises calib.errors.NotConverged: If no calibration has a result.
    """
    program = forms()["program"]
    blocks = [range(first, min(first + BLOCK, runs)) for first in range(0, runs, BLOCK)]
    what = hashlib.sha256(pickle.dumps(planned)).hexdigest()
    keys = [
        content_key(
            {"of": STUDY, "study": what, "first": block.start, "stop": block.stop, "program": program}
        )
        for block in blocks
    ]
    found: dict[int, list[Repetition]] = {}
    for number, key in enumerate(keys):
        if kept is not None and (rows := kept.get(key)) is not None:
            found[number] = [_repetition(row) for row in rows]
            done(len(rows))
    missing = [number for number in range(len(blocks)) if number not in found]
    work = ((planned, blocks[number], program) for number in missing)
    for at, outcomes in results_of(calibrate_block, work, workers):
        if kept is not None:
            kept.add(keys[missing[at]], [asdict(one) for one in outcomes])
        found[missing[at]] = outcomes
        done(len(outcomes))
    return study_of(planned.bench, [one for number in range(len(blocks)) for one in found[number]])


def calibrate_block(planned: PlannedStudy, runs: range, program: str) -> list[Repetition]:
    """Do one block of a study.

    program: Hash of the program that hands out the work.
    Raises BenchError: If this worker runs another program.
    """
    require_program_of(program)
    return planned.calibrate(runs)


def _repetition(row: dict) -> Repetition:  # type: ignore[type-arg]
    sequences = {name: tuple(row[name]) for name in ("names", "values", "sigmas")}
    return Repetition(**{**row, **sequences})
