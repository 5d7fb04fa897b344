"""What a page needs of a run's ``plan.json`` and ``results.json``. Reads these two files, and writes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.base.errors import StorageError
from bench.records.estimates import coverage_factor
from bench.records.reading import read_json
from bench.records.run_folder import PLAN, RESULTS


@dataclass(frozen=True)
class RunPlan:
    """The plan of a run."""

    poses: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    most_poses: int = 0  # How many poses there are at most, with those that the run may still choose
    untils: Sequence[Mapping[str, Any]] = ()  # ``untils`` of the plan
    steps: Sequence[Mapping[str, Any]] = ()  # ``steps`` of the plan, in order
    prompts: Sequence[int] = ()
    duration_s: float = 0.0  # Planned time, s
    most_bytes: int = 0  # Disk space that the run may need, bytes
    fault: str = ""  # Why there is no plan; empty if there is one


def read_plan(folder: Path) -> RunPlan:
    """Read the plan of a run.

    Returns: Also if there is none, or it is damaged: then with ``fault``.
    """
    path = folder / PLAN
    try:
        plan = read_json(path)
        poses = {int(pose["index"]): pose for pose in plan["poses"]}
        return RunPlan(
            poses,
            max(len(poses), int(plan.get("most_poses", 0))),
            plan.get("untils", ()),
            plan["steps"],
            [int(step["number"]) for step in plan["steps"] if step["what"] == "prompt"],
            float(plan["duration_s"]),
            int(plan.get("most_bytes", 0)),
        )
    except StorageError as error:
        return RunPlan(fault=f"{PLAN} cannot be read: {error.what}")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        return RunPlan(fault=f"{PLAN} is damaged, or another version wrote it ({error}).")


def read_final(folder: Path) -> dict[str, float]:
    """Read the uncertainties that a run has reached in the end.

    Returns: ``coverage_factor``; and, expanded by it, ``expanded_fx_px`` and ``worst_corner_px``, as far as
      the results state them. Empty if there are no results.
    """
    try:
        results = read_json(folder / RESULTS)
        calibration = results["calibration"]
        k = coverage_factor(calibration, "fx")
        found = {"coverage_factor": k, "expanded_fx_px": k * float(calibration["sigma"]["fx"])}
        corner = results.get("projection", {}).get("worst_corner", {}).get("expanded_px")
        return found if corner is None else {**found, "worst_corner_px": float(corner)}
    except (StorageError, ValueError, KeyError, TypeError, AttributeError):
        return {}
