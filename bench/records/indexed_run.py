"""One run as the index lists it. `bench.records.run_index` makes it from the files of the run folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from bench.records.estimates import Estimate, parameters_data


@dataclass(frozen=True)
class IndexedRun:
    """One run."""

    folder: str
    id: str
    # sequence, station, camera, operator, simulated, rehearsal: What was run; ``camera`` is the serial
    # number, empty while no camera has answered.
    sequence: str
    station: str
    camera: str
    operator: str | None
    simulated: bool
    rehearsal: bool
    begun_utc: str  # Time of the start, ISO 8601
    how: str  # ``finished``, ``aborted``, ``failed``, ``running``, or ``cut off``
    sealed: bool  # Whether it is sealed
    # accepted, recordings, deviations: Number of recorded poses, of recordings made for them (also lost
    # ones), and of deviations from the sequence.
    accepted: int
    recordings: int
    deviations: int
    # Temperature of the camera, mean of the accepted recordings, degrees Celsius; None if the camera does not
    # report it.
    temperature_c: float | None
    # model, rms_px: Model and root mean square of the residuals of its calibration, px; None without a
    # calibration.
    model: str | None
    rms_px: float | None
    parameters: Mapping[str, Estimate]  # By name
    # The common k of its expanded uncertainties; None without a calibration, or if an earlier version made it.
    coverage_factor: float | None = None
    # ledger_number, ledger_head: Its number in the ledger of its bench, and the hash of its line there; None
    # for a rehearsal.
    ledger_number: int | None = None
    ledger_head: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the run as JSON carries it."""
        return {**asdict(self), "parameters": parameters_data(self.parameters)}
