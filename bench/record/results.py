"""What results.json holds: the types that its writer, the report, the certificate, the table and the panel share.

docs/results.md explains the values. ``NotRequired`` parts are missing where they do not apply. A dataclass, also one of
the engine, is written field by field (`bench.base.bounded_json.canonical_json`), and is an object again when the file
is read (`bench.record.stored_run.results_of`).
U of a value is its ``coverage_factors``, or else ``coverage_factor``, times its ``sigma``. Print and collimator are in
mm, images in px, readings in degrees, unless a name says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import (
    Any,
    Literal,
    NotRequired,  # pydantic checks these types, on Python 3.11 too
)

from typing_extensions import TypedDict

from bench.base.failure import Failure
from bench.record.device_end import DeviceEnd
from bench.record.events import (
    AttemptData,
    CauseData,
    LedgerPlace,
    LightSettingsData,
    StateEntered,
    UntilDecided,
)
from bench.record.measured_facts import GateData, ImageFacts
from calib.model.result_parts import Amplitude, BudgetRow, CameraCheck, GimbalEstimate, Witness

Numbers = Mapping[str, float]
"""A number by name: ``fx``, ``cx``, ``r`` ... or by axis: ``pan``, ``tilt``."""
Verdict = Literal["pass", "conditionalPass", "conditionalFail", "fail"]
"""Of a statement of conformity: kept by the guard band or more, by less; missed by the guard band at most, by more."""


class CovarianceData(TypedDict):
    """Covariance of parameters: their names in order, and the matrix by rows."""

    names: Sequence[str]
    matrix: Sequence[Sequence[float]]


class ViewData(TypedDict):
    """A view of a calibration: its stars, its residuals, its rotation and the centre of the field."""

    name: str
    n: int  # Number of stars
    rms_px: float
    mean_px: float
    rotation: Sequence[Sequence[float]]  # (3, 3), from the collimator to the camera
    centre_mm: Sequence[float]


class BoresightData(TypedDict):
    """The rotation from the stage's flange to the camera (`calib.model.result_parts.Boresight`)."""

    camera_from_flange: Sequence[Sequence[float]]  # (3, 3)
    vector_deg: Sequence[float]  # The same as a rotation vector
    expanded_deg: Sequence[float]  # U about the camera's x, y and z
    covariance_rad2: Sequence[Sequence[float]]  # (3, 3)
    sight: Sequence[float]  # The ray through the middle of the image, a unit vector in the flange's frame
    right_down_deg: Sequence[float]  # Its angles from the flange's z towards x and towards y
    sight_expanded_deg: Sequence[float]  # U of the ray along the camera's x and y
    sight_covariance_rad2: Sequence[Sequence[float]]  # (2, 2)


@dataclass(frozen=True)
class MountFace:
    """How the camera looks against a face of its mount."""

    name: str
    normal_in_camera: Sequence[float]
    angle_deg: float  # Between the normal and the ray through the middle of the image
    expanded_deg: float


class CameraData(TypedDict):
    """A calibrated camera: what is needed to project, with its uncertainty."""

    model: str
    image_size: Sequence[int]
    camera: Numbers
    sigma: Numbers
    covariance: NotRequired[CovarianceData]
    coverage_factor: NotRequired[float]
    coverage_factors: NotRequired[Numbers]  # The k of each value; empty or missing if all have the common one


class CalibrationData(CameraData):
    """A calibration (`calib.calibration.Calibration.to_dict`)."""

    engine: Mapping[str, str | int]  # ``name`` and ``version``
    converged: bool
    iterations: int
    collimator: Numbers | None  # None for a planar model
    rms_px: float
    mean_px: float
    variance_factor: float
    degrees_of_freedom: int
    disagreement: float
    left_out_rms_px: float | None
    budget: Mapping[str, Numbers]  # Standard uncertainty of each parameter by source
    views: Sequence[ViewData]
    notes: Sequence[str]
    remarks: Sequence[str]  # Those of the notes that do not doubt the values
    gimbal: NotRequired[GimbalEstimate]
    boresight: NotRequired[BoresightData]
    budget_rows: Sequence[BudgetRow]
    not_included: Sequence[str]
    witnesses: Sequence[Witness]
    amplitudes: Sequence[Amplitude]


@dataclass(frozen=True)
class Direction:
    """Expanded uncertainty of a direction."""

    expanded_px: float
    expanded_urad: float


@dataclass(frozen=True)
class WorstCorner:
    """Expanded uncertainty of a direction in the corner of the sensor where it is largest."""

    corner: str  # ``top left`` ...
    expanded_px: float
    expanded_urad: float


@dataclass(frozen=True)
class SupportedPart:
    """The part of the sensor with stars near: ``reach_px`` to the next star; its share, and the largest U there."""

    reach_px: float
    share: float
    expanded_px: float | None  # None, as the next, where nothing determines a direction
    expanded_urad: float | None


@dataclass(frozen=True)
class Projection:
    """Uncertainty of directions over the sensor."""

    coverage_factor: float
    worst_corner: WorstCorner
    median: Direction
    supported: SupportedPart | None


@dataclass(frozen=True)
class StatedPassport:
    """What was known of the collimator beforehand."""

    source: str  # ``sequence``, ``station``, ``station certificate`` or ``command line``
    name: str
    collimator: str | None
    number: str | None
    date: str | None
    valid_until: str | None
    temperature_c: float | None
    values: Numbers
    sigma: Numbers
    sha256: str
    sealed_by: str | None = None


@dataclass(frozen=True)
class ReadingsStatement:
    """What the station states about the readings of its gimbal."""

    source: str
    reading_sigma_deg: float
    scale_sigma: float
    eccentricity_deg: float


@dataclass(frozen=True)
class ReadingsUse:
    """Whether the readings of the gimbal entered the calibration, with what statement, or why not."""

    entered: bool
    statement: ReadingsStatement | None
    # A `calib.model.gimbal_readings.ParallaxBound`; ``parallax`` and ``parallax_sigma`` with a collimator.
    bound: Numbers | None
    why_not: str | None


@dataclass(frozen=True)
class GimbalComparison:
    """The hand-eye check: the rotations against the readings of the gimbal."""

    rms_arcsec: float
    scale: Numbers
    scale_sigma: Numbers
    agrees: bool
    excess_arcsec: float
    verdict: str
    says: Sequence[str]
    pairs: Numbers | None  # ``ratio spread count`` of angle seen over angle read, over all pairs of poses
    # A fault that the readings may show: ``kind axis pose size_deg sigma_deg probability claimed``; poses from 0.
    slip: Mapping[str, str | float | bool | None] | None
    faults: Sequence[Mapping[str, str | float | bool | None]]


@dataclass(frozen=True)
class Halves:
    """Split half: every other pose against the rest, over the sensor."""

    rms_px: float
    worst_px: float
    expected_px: float
    ratio: float | None = None  # None in results of before


class PoseData(TypedDict):
    """A pose: its angles and its stars; of a run, its recordings too."""

    index: int
    name: str
    commanded_deg: Numbers | None  # None, as the next, of a file that is of no run
    measured_deg: Numbers | None
    measured_after_deg: NotRequired[Numbers]
    attempts: NotRequired[Sequence[AttemptData]]
    image: NotRequired[ImageFacts | None]
    flicker_hz: NotRequired[float | None]
    flicker_duty: NotRequired[float | None]  # Share of a period in which the light is on
    named_by: NotRequired[str | None]  # ``tag`` or ``gimbal``
    stars: int
    rms_px: float | None  # None if the pose is not part of the calibration
    mean_px: float | None


@dataclass(frozen=True)
class ComparisonRow:
    """A value against the truth of the simulated world."""

    name: str
    value: float
    sigma: float
    truth: float
    error: float
    error_sigmas: float


class RunData(TypedDict):
    """Where, when and with what the results were made, by a run or, ``offline``, from files without devices."""

    id: str
    sequence: NotRequired[str | None]
    station: NotRequired[str | None]
    started_utc: NotRequired[str]
    finished_utc: NotRequired[str]
    offline: NotRequired[bool]
    calibrated_utc: NotRequired[str]
    of_run: NotRequired[str | None]
    seed: NotRequired[int | None]
    operator: NotRequired[str | None]
    laboratory: NotRequired[str | None]
    collimator: NotRequired[Mapping[str, Any] | None]  # Section ``collimator`` of the station file
    target: NotRequired[Mapping[str, str]]
    board: NotRequired[str]
    simulated: NotRequired[bool]
    camera: NotRequired[str]  # ``event`` or ``frame``
    resumed: NotRequired[int]
    plugins: NotRequired[Mapping[str, Sequence[str]]]
    ledger: NotRequired[LedgerPlace]
    software: NotRequired[Mapping[str, str]]


class CameraConditions(TypedDict):
    """Settings of the camera as read back, with its temperature: those of an event or of a frame camera."""

    biases: NotRequired[Mapping[str, int]]
    filters: NotRequired[Mapping[str, bool]]
    temperature_c: NotRequired[float | None]
    illumination_lux: NotRequired[float | None]
    pictures: NotRequired[int]
    bits: NotRequired[int]
    exposure: NotRequired[float]
    gain: NotRequired[float]


class Conditions(TypedDict):
    """Settings of light and camera at the last accepted recording."""

    light: LightSettingsData
    camera: CameraConditions


@dataclass(frozen=True)
class ProjectionChange:
    """ProjectionChange of the projection since an earlier calibration, px and in units of its U."""

    rms_px: float
    largest_px: float
    largest_ratio: float
    px_there: float
    at_px: Sequence[float]


@dataclass(frozen=True)
class StatedCheck(CameraCheck):
    """A stated calibration against that of new views; besides its fields, the file has ``right`` and ``cause``."""

    stated: Mapping[str, Any] = field(default_factory=dict)  # ``name kind uncertainty sha256`` of the file


@dataclass(frozen=True)
class LimitStatement:
    """A limit of the station or of the sequence, and whether the result keeps it."""

    result: str
    specification: str
    stated_by: str  # ``station`` or ``sequence``
    lower: float | None
    upper: float | None
    value: float | None  # None, as `expanded`, if the calibration did not estimate it
    expanded: float | None
    verdict: Verdict


@dataclass(frozen=True)
class Conformity:
    """PASS or FAIL of a run by the limits of its station and its sequence."""

    passed: bool
    rule: str
    statements: Sequence[LimitStatement]
    reasons: Sequence[str]  # Why the run fails whatever its limits say


class PreviousData(TypedDict):
    """The last calibration of the same camera on this bench, and the change since; or why there is none."""

    run: str | None
    why_not: NotRequired[str]
    number: NotRequired[int]
    finished_utc: NotRequired[str | None]
    sequence: NotRequired[str | None]
    temperature_c: NotRequired[float | None]
    seal: NotRequired[str]
    results_sha256: NotRequired[str]
    calibration: NotRequired[CameraData]
    change: NotRequired[ProjectionChange | None]


class ParallaxData(TypedDict, total=False):
    """Where the entrance pupil is by the parallax test, or ``why_not``."""

    why_not: str
    walk_mm: Sequence[Any]  # Of the centre of the disc, by axis of the gimbal
    walk_covariance_mm2: Sequence[Any]
    pupil_off_pivot_mm: Numbers  # ``value`` and ``sigma``, as those that follow
    axes_differ: bool
    difference_in_sigmas: float
    without_rim: Sequence[str]
    station_entry: str
    stated_mm: Numbers | None  # Of the station file
    # ``value``, ``sigma``, ``source``; None, as the rest, if none is stated
    defocus: Mapping[str, Any] | None
    parallax: Numbers | None
    fx_px: Numbers | None
    says: Sequence[str]


class Results(TypedDict):
    """The content of results.json of a run, or of a calibration from files without devices."""

    schema: str
    rehearsal: NotRequired[bool]  # Nothing was measured
    run: RunData
    devices: NotRequired[Mapping[str, Any]]  # Identities, as the journal's ``devices`` holds them
    conditions: NotRequired[Conditions]
    calibration: CalibrationData
    projection: NotRequired[Projection | None]
    passport: NotRequired[StatedPassport | None]
    gimbal_readings: NotRequired[ReadingsUse | None]
    halves: NotRequired[Halves]
    gimbal: NotRequired[GimbalComparison]
    parallax: NotRequired[ParallaxData]
    mount_faces: NotRequired[Sequence[MountFace]]
    check: NotRequired[StatedCheck]
    poses: NotRequired[Sequence[PoseData]]
    gates: NotRequired[Sequence[GateData]]
    untils: NotRequired[Sequence[UntilDecided]]
    deviations: NotRequired[Sequence[str]]
    holds: NotRequired[Sequence[str]]  # Pauses that a person asked for and ended
    failures: NotRequired[Sequence[Failure]]
    devices_left: NotRequired[Sequence[DeviceEnd]]
    states: NotRequired[Sequence[StateEntered]]
    # ``view path size_bytes sha256`` of each input file of a calibration without devices
    sources: NotRequired[Sequence[Mapping[str, str | int]]]
    truth: NotRequired[Mapping[str, Any] | None]
    comparison: NotRequired[Sequence[ComparisonRow]]
    previous: NotRequired[PreviousData]
    causes: NotRequired[Sequence[CauseData]]  # The most probable first; empty or missing if there are none
    conformity: NotRequired[Conformity]  # Missing without limits
