"""Studies by many workers: blocks of simulated calibrations, each kept on the disk as soon as it is done."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.base.home import forms
from bench.cluster.work import KeptRows, Workers, content_key, require_program_of, results_of
from bench.plan.plan import load_documents, make_plan
from bench.records.storage import storage_errors
from bench.results.forecasts import expected_bench
from bench.stations.station import Station
from calib.calibration import CalibrationOptions
from calib.studies.monte_carlo import MonteCarloStudy, Repetition, calibrate_once, study_of
from calib.studies.predicted_views import ExpectedBench
from sequences.reader import Located

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
    """Run a study; blocks ``kept`` on the disk by an earlier command are used, new ones are kept; None for neither."""
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
    """Do one block of a study."""
    require_program_of(program)
    return planned.calibrate(runs)


def _repetition(row: dict) -> Repetition:  # type: ignore[type-arg]
    sequences = {name: tuple(row[name]) for name in ("names", "values", "sigmas")}
    return Repetition(**{**row, **sequences})


def sequence_poses_deg(sequence: str, station: str) -> tuple[list[dict[str, float]], Located[Station]]:
    """Return the poses that a sequence records, as ``pan_deg`` and others, and the station file."""
    planned = make_plan(*load_documents(sequence, station))
    poses = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    return poses, planned.station


@dataclass(frozen=True)
class PlannedStudy:
    """What all calibrations of a study have in common."""

    bench: ExpectedBench
    # For each pose its angles, named as in the engine (``pan_deg``), degrees.
    poses_deg: Sequence[Mapping[str, float]]
    options: CalibrationOptions
    seed: int
    # Standard deviation, for each axis, of the distance between a view's centre and the shared centre, mm.
    drift_mm: float = 0.0
    outliers: float = 0.0

    def calibrate(self, runs: range) -> list[Repetition]:
        """Calibrate a simulated camera repeatedly with random noise (Monte Carlo method, JCGM 101)."""
        return [
            calibrate_once(
                self.bench,
                self.poses_deg,
                self.options,
                self.seed,
                run,
                drift_mm=self.drift_mm,
                outliers=self.outliers,
            )
            for run in runs
        ]


def plan_study(
    sequence: str,
    station: str,
    *,
    seed: int,
    noise_px: float | None,
    drift_mm: float,
    outliers: float,
    model: str,
    loss: str,
) -> PlannedStudy:
    """Read the files of a study; without ``noise_px``, the station's value holds."""
    poses, described = sequence_poses_deg(sequence, station)
    bench = expected_bench(described, noise_px=noise_px)
    options = CalibrationOptions(model=model, loss=loss)  # type: ignore[arg-type]
    return PlannedStudy(bench, poses, options, seed, drift_mm, outliers)


def write_study_plot(study: MonteCarloStudy, path: Path) -> None:
    """Draw the z-scores of each parameter as histograms beside the normal distribution, in an SVG file."""
    from bench.report.trend_plots import study_plot

    svg = study_plot(study.names, (study.values - study.truth) / study.sigmas, study.z_rms)
    with storage_errors(path):
        path.write_text(svg + "\n", encoding="utf-8")
