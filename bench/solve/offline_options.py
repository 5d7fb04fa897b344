"""Options of an offline calibration, parsed from the command line."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from bench.base.errors import UsageError
from bench.base.image_size import parse_image_size
from bench.plan.job import Job
from bench.plan.passport_file import read_passport_file
from bench.plan.passports import NO_PASSPORT, PassportChoice, PassportInUse, PassportSource, station_passport
from bench.plan.plan import DEFAULT_MODEL
from bench.solve.point_files import Origin
from bench.solve.solve_options import solve_options, with_statements
from bench.stations.station import OfflineStation, load_offline_station
from calib.boards.board import Board
from calib.calibration import REFERENCE_MODELS, ModelName
from calib.engine import CalibrationOptions
from calib.errors import CalibrationError
from calib.target import StarTarget
from sequences.errors import DocumentFaults
from sequences.reader import check_document
from sequences.schema import ImageKind
from sequences.script import SolveStep
from sequences.solve_schema import Readings

#: Coefficients that are estimated from a board if nobody says which: those of Kalibr's radtan and of ROS's calibrator.
#: With k1 and k2 alone, cx of the frame camera of EF-Calib's published corners moves by 7.6 px, at a U of .5 px and
#: without a note. The joint adjustment has p1 and p2 always.
_LENS_OF_BOARDS = ("k1", "k2", "p1", "p2")


@dataclass(frozen=True)
class StationFile:
    """The station file that the command line gave for what is known of target and collimator."""

    name: str  # As it was given: a path, or the name of a station that is included
    path: str
    sha256: str  # Hash of its bytes
    text: str = ""  # Its content; empty in results of earlier versions, which used its target alone
    passport_source: PassportSource | None = None  # Which passport of the options it states, if any

    @property
    def station(self) -> OfflineStation | None:
        """What the file states; None without its text."""
        return check_document(self.text.encode(), self.name, OfflineStation).value if self.text else None


@dataclass(frozen=True)
class OfflineOptions:
    """Options of an offline calibration. An option that is None is that of the run's last solve step, or a default.

    ``guard_band``, ``readings`` and ``image`` are options of earlier versions, which their sealed results state.
    """

    model: ModelName | None = None  # See `CalibrationOptions`
    distortion: str | None = None  # Name of a set of coefficients
    guard_band: float | None = None  # See `CalibrationOptions`
    passport: PassportInUse | None = None
    without_passport: bool = False  # Whether to use no passport, not even that of the run
    # ``witness``: the readings of the run's gimbal do not enter the adjustment.
    readings: Readings | None = None
    image_size: tuple[int, int] | None = None  # Width and height for point files, px
    view_numbers: tuple[int, ...] | None = None  # Numbers of the views to use, from 1; None for all
    image: ImageKind = "auto"  # Kind of event image for RAW captures
    origin: Origin = "corner"  # Pixel origin of point files
    target: StarTarget = field(default_factory=StarTarget)
    # The board at finite distance that the views show in place of the star target; None for the star target.
    board: Board | None = None
    # Cutoff frequency at which pictures of a moving camera are reconstructed from RAW files, Hz; None for
    # recordings of a camera that stands still before a flickering target.
    reconstruct_hz: float | None = None
    # The station file of ``target``, for files that are of no run; None for the standard target.
    station: StationFile | None = None

    @classmethod
    def from_command_line(
        cls,
        *,
        model: ModelName | None = None,
        distortion: str | None = None,
        image_size: str | None = None,
        views: str | None = None,
        origin: Origin = "corner",
        station: str | None = None,
        passport: str | None = None,
        board: str | None = None,
        reconstruct_hz: float | None = None,
    ) -> Self:
        """Parse the options as the command line writes them; None stands for those of the run, or the defaults.

        ``image_size`` as ``1280x720``, ``views`` as ``1,5,9``, ``origin`` ``corner``, ``centre`` or ``matlab``,
        ``passport`` a file or ``none``, ``board`` as `calib.boards.board.Board.parse` reads it, and
        ``reconstruct_hz`` in Hz.
        """
        shown = parse_board(board, model, passport)
        if reconstruct_hz is not None and shown is None:
            raise UsageError(
                "Pictures of a moving camera are reconstructed for boards only.",
                where="--reconstruct",
                remedy="Describe the board: --board checkerboard:11x7:20mm.",
            )
        model = "planar" if shown else model
        named = passport if passport != NO_PASSPORT else None
        uses_passport = passport != NO_PASSPORT and model not in REFERENCE_MODELS
        target, station_file, stated = _of_station(station, with_passport=uses_passport and named is None)
        made = cls(
            model=model,
            distortion=distortion,
            passport=passport_of_file(Path(named)) if named else stated,
            without_passport=passport == NO_PASSPORT,
            image_size=parse_image_size(image_size),
            view_numbers=_parse_view_numbers(views),
            origin=origin,
            target=target,
            board=shown,
            reconstruct_hz=reconstruct_hz,
            station=station_file,
        )
        try:
            made.without_run()
        except CalibrationError as error:
            raise UsageError(error.what, remedy=error.remedy) from error
        return made

    def without_run(self, passport: PassportInUse | None = None) -> CalibrationOptions:
        """Return the engine's options for views that are not from one run; without a model, ``auto``."""
        none = self.without_passport or self.model in REFERENCE_MODELS
        used = self.passport or (None if none else passport)
        options = CalibrationOptions(
            self.model or DEFAULT_MODEL,
            self.distortion or (_LENS_OF_BOARDS if self.board else ("k1", "k2")),
            passport=used.passport if used else None,
            guard_band=self.guard_band or 1.0,
        )
        station = self.station.station if self.station and not self.board else None
        return options if station is None else with_statements(options, station)

    def for_one_run(self) -> Self:
        """Return the options without the station's passport: a run has its own station."""
        of_station = self.passport is not None and self.passport.source != "command line"
        return replace(self, passport=None) if of_station else self

    def of_run(
        self, job: Job, step: SolveStep, measured_deg: Sequence[Mapping[str, float]]
    ) -> CalibrationOptions:
        """Return the engine's options for views of one run, with the stage's angles as the journal holds them."""
        changed = self.step_of_run(step)
        options = solve_options(job, changed, measured_deg)
        if self.without_passport or self.passport is not None:
            passport = self.passport.passport if self.passport else None
            options = replace(options, passport=None if changed.model in REFERENCE_MODELS else passport)
        return options if self.distortion is None else replace(options, distortion=self.distortion)

    def step_of_run(self, step: SolveStep) -> SolveStep:
        """Return the last solve step of a run with the options of the command line."""
        return replace(
            step,
            model=self.model or step.model,
            guard_band=self.guard_band or step.guard_band,
            readings=self.readings or step.readings,
        )


def _of_station(
    name: str | None, *, with_passport: bool
) -> tuple[StarTarget, StationFile | None, PassportInUse | None]:
    """Return the target of the station that the command line names, its file, and the passport that it states."""
    if not name:
        return StarTarget(), None, None
    read = load_offline_station(name)
    path = (read.folder or Path()) / Path(read.file).name
    choice = station_passport(read, datetime.now(UTC).date()) if with_passport else PassportChoice()
    if choice.faults:
        raise DocumentFaults(choice.faults)
    stated = choice.in_use
    file = StationFile(
        name,
        str(path.absolute()),
        hashlib.sha256(read.text).hexdigest(),
        read.text.decode(),
        stated.source if stated else None,
    )
    return read.value.target.pattern(), file, stated


def passport_of_file(path: Path, name: str = "") -> PassportInUse:
    """Read the passport that the command line names, or a copy of it; raise UsageError or StorageError."""
    passport, data, seal = read_passport_file(path)
    return PassportInUse(passport, data, "command line", name or path.name, seal=seal)


def parse_board(text: str | None, model: str | None = None, passport: str | None = None) -> Board | None:
    """Read a board, which needs the planar model and takes no passport."""
    if text is None:
        return None
    if model not in (None, "planar") or passport not in (None, NO_PASSPORT):
        raise UsageError(
            "A board at finite distance has no collimator before it.",
            where="--board",
            remedy="Leave out --passport and --model; the planar model is used.",
        )
    try:
        return Board.parse(text)
    except CalibrationError as error:
        raise UsageError(error.what, where="--board", remedy=error.remedy) from error


def _parse_view_numbers(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"[1-9]\d{0,5}", word) for word in words) or len(set(words)) != len(words):
        raise UsageError(
            f"{text!r} is not a list of view numbers.",
            where="--views",
            remedy="Write different numbers from 1, for example 1,5,9.",
        )
    return tuple(int(word) for word in words)
