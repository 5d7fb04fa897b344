"""The calibration that a step ``check`` of a sequence checks: its file, and the copy that the run folder keeps."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base.errors import BenchError, UsageError
from bench.plan.passports import require_copy, setting_path
from bench.stations.station import ExpectedConfig
from sequences.reader import Located
from sequences.schema import Sequence
from sequences.script import SolveStep, Step
from sequences.tree import Fault

if TYPE_CHECKING:  # it loads OpenCV, which plans without a check do not need
    from bench.camera_files.reader import CameraFile


@dataclass(frozen=True, eq=False)
class StatedCamera:
    """The calibration that a run checks."""

    name: str  # As the sequence names it
    file: CameraFile

    def to_dict(self) -> dict[str, Any]:
        """Return what plan and results state about it."""
        return {
            "name": self.name,
            "kind": self.file.kind,
            "uncertainty": self.file.covariance is not None,
            "sha256": hashlib.sha256(self.file.data).hexdigest(),
        }


@dataclass(frozen=True, eq=False)
class StatedCameraChoice:
    """The calibration of the steps ``check``; None without such a step, or with a fault."""

    in_use: StatedCamera | None = None
    faults: tuple[Fault, ...] = ()


def choose_stated_camera(
    sequence: Located[Sequence], steps: Iterable[Step], expected: ExpectedConfig | None, *, copy: Path | None
) -> StatedCameraChoice:
    """Find and read the calibration that the steps ``check`` name; ``copy`` in the run folder goes first.

    ``expected`` is the station's; a new run with a sensor of another size is refused.
    """
    named = [
        (step, step.checked) for step in steps if isinstance(step, SolveStep) and step.checked is not None
    ]
    if not named:
        return StatedCameraChoice()
    step, name = named[0]
    path = setting_path(sequence, step.path, "calibration", "solve")
    other = next((camera for camera, text in named if text != name), None)
    if other is not None:
        fault = sequence.fault(other.path, "the check steps name different calibrations; a run checks one.")
        return StatedCameraChoice(faults=(fault,))
    try:
        stated = StatedCamera(name, _read(sequence.file_at(path, name), copy))
        if copy is None and expected is not None:
            _require_same_sensor(stated.file, expected.image_size)
        return StatedCameraChoice(stated)
    except BenchError as error:
        return StatedCameraChoice(faults=(sequence.fault(path, str(error)),))


def _read(file: Path, copy: Path | None) -> CameraFile:
    """Read the copy if there is one, else the named file; raises BenchError."""
    from bench.camera_files.reader import read_camera_file

    if copy is None and not file.exists():
        raise UsageError("There is no such file or folder.", where=str(file), remedy="Check the path.")
    return read_camera_file(file if copy is None else require_copy(copy))


def _require_same_sensor(file: CameraFile, expected: tuple[int, int]) -> None:
    if file.camera.image_size != expected:
        sizes = [" x ".join(map(str, size)) for size in (file.camera.image_size, expected)]
        raise UsageError(
            f"This calibration is of a sensor of {sizes[0]} px; the station expects {sizes[1]} px.",
            where=str(file.path),
            remedy="Check a calibration of this camera, or correct `expected.image_size` of the station.",
        )
