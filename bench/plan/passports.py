"""The collimator's passport of a run: which one the documents name, its file, and whether it suits the bench.

It is the sequence's, else the station's passport or certificate. A resumed or repeated run reads the copy in its
folder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bench.base.errors import BenchError, EvidenceError, UsageError
from bench.base.home import home_folder
from bench.plan.passport_file import passport_bytes, read_passport_file
from bench.record.results import StatedPassport
from bench.stations.station import OfflineStation
from bench.stations.station_budget import CertificateConfig, CollimatorConfig
from calib.calibration import REFERENCE_MODELS
from calib.model.collimator import CENTRE
from calib.model.passport import Passport
from sequences.reader import Located
from sequences.schema import Sequence
from sequences.script import SolveStep, Step
from sequences.tree import DocumentPath, Fault

if TYPE_CHECKING:
    from bench.evidence.passport_seal import PassportSeal

NO_PASSPORT = "none"
"""Word in a sequence: use no passport, not even the station's."""
MOST_DEGREES_APART = 5.0
"""Largest difference between the temperatures of passport and bench without a caution, degrees Celsius: a tube of
aluminium becomes longer by 0.01 %."""

PassportSource = Literal["sequence", "station", "station certificate", "command line"]


def setting_path(document: Located[Sequence], path: DocumentPath, key: str, word: str) -> DocumentPath:
    """Return the path of a step's setting in the file."""
    places = ((*path, key), ("defaults", word, key))
    return next((place for place in places if place in document.tree.values), path)


def require_copy(copy: Path) -> Path:
    """Return the copy that the folder of a run keeps of a file, which must be there."""
    if not copy.is_file():
        raise UsageError(
            f"The run folder has no {copy.name}, which this run uses.",
            where=str(copy),
            remedy="Restore it from a copy of the run.",
        )
    return copy


def determines_one_view(passport: Passport) -> bool:
    """Return whether one view is enough to calibrate a camera: the passport holds the collimator's whole centre.

    Own count: a homography has 8 degrees of freedom. With x, y and r known, fx, fy, cx, cy and a rotation are 7
    unknowns; with r alone 9.
    """
    return set(CENTRE) <= set(passport.names)


@dataclass(frozen=True, eq=False)
class PassportInUse:
    """The passport that a run's solve steps use."""

    passport: Passport  # The collimator's parameters and their covariance
    data: bytes
    # What named it: the sequence, the station, the values of a certificate in the station file, or an option
    # of an offline calibration.
    source: PassportSource
    name: str  # Name of the file, without its folder
    other_accepted: bool = False  # Whether the sequence accepts a passport of another collimator
    # The seal of the file; None if it has none, and for the values of a certificate in the station file,
    # which the seal of the run covers.
    seal: PassportSeal | None = None

    @property
    def is_unsealed(self) -> bool:
        """Whether nothing shows that the file is as it was made."""
        return self.source != "station certificate" and self.seal is None

    @property
    def serial(self) -> str | None:
        """Serial number or name of the collimator, if the passport states it."""
        return _text(self.passport.conditions.get("collimator"))

    @property
    def valid_until(self) -> date | None:
        """Last day of validity, if the passport states it."""
        return _date(self.passport.conditions.get("valid_until"))

    @property
    def temperature_c(self) -> float | None:
        """Temperature for which the passport holds, degrees Celsius, if the passport states it."""
        stated_c = self.passport.conditions.get("temperature_c")
        if isinstance(stated_c, int | float) and not isinstance(stated_c, bool):
            return float(stated_c)
        return None

    def to_dict(self) -> dict[str, Any]:
        """Return what results.json states: origin, identity, validity, values, standard uncertainties, hash."""
        stated, passport = self.passport.conditions, self.passport
        sigma = {name: float(passport.covariance[i, i] ** 0.5) for i, name in enumerate(passport.names)}
        shown = StatedPassport(
            source=self.source,
            name=self.name,
            collimator=self.serial,
            number=_text(stated.get("certificate")),
            date=self._date_of_issue(),
            valid_until=_text(stated.get("valid_until")),
            temperature_c=self.temperature_c,
            values=dict(passport.values_by_name),
            sigma=sigma,
            sha256=hashlib.sha256(self.data).hexdigest(),
            sealed_by=self.seal.fingerprint if self.seal else None,
        )
        return asdict(shown)

    def _date_of_issue(self) -> str | None:
        """Return the date of the certificate; of a passport that was made from views, the date when it was made."""
        stated = self.passport.conditions
        if "certificate" in stated:
            return _text(stated.get("issued"))
        return _text(stated.get("issued")) or (_text(stated.get("made_utc")) or "")[:10] or None

    def cautions(self, collimator: CollimatorConfig, on: date) -> list[str]:
        """Return a sentence for each doubt: unsealed, expired, other temperature or collimator, or none named."""
        cautions = []
        if self.is_unsealed:
            cautions.append(
                f"The collimator's passport {self.name} is not sealed: nothing shows that its values are as they were "
                "made."
            )
        if self.valid_until is not None and self.valid_until < on:
            cautions.append(f"The collimator's passport expired on {self.valid_until}; the run is of {on}.")
        cautions += self._temperature_caution(collimator.temperature_c)
        if collimator.serial is None:
            return cautions
        if self.serial is None:
            cautions.append(
                "The collimator's passport does not name its collimator, so nothing shows that it belongs to "
                f"{collimator.serial}."
            )
        elif self.serial != collimator.serial:
            cautions.append(
                f"The passport belongs to the collimator {self.serial}; the station's is {collimator.serial}. "
                "The sequence accepts it (other_collimator: accept)."
            )
        return cautions

    def _temperature_caution(self, bench_c: float | None) -> list[str]:
        if self.temperature_c is None:
            return []
        if bench_c is None:
            what = f"The collimator's passport holds at {self.temperature_c:g} °C; the station does not state the "
            return [what + "temperature of the bench (collimator: {temperature_c})."]
        apart = abs(self.temperature_c - bench_c)
        if apart <= MOST_DEGREES_APART:
            return []
        what = (
            f"The collimator's passport holds at {self.temperature_c:g} °C; the bench is at {bench_c:g} °C, "
        )
        return [f"{what}{apart:.3g} °C apart. Its focal length differs by the thermal expansion."]


@dataclass(frozen=True)
class PassportChoice:
    """The passport of a run, and what was found while it was read."""

    # The passport; None if no solve step uses one, or if it cannot be used.
    in_use: PassportInUse | None = None
    steps: frozenset[int] = frozenset()
    faults: tuple[Fault, ...] = ()  # Why it cannot be used
    remarks: tuple[Fault, ...] = ()  # What speaks against it

    @property
    def steps_for_one_pose(self) -> frozenset[int]:
        """Numbers of the solve steps that one pose is enough for (`determines_one_view`)."""
        if self.in_use is not None and not determines_one_view(self.in_use.passport):
            return frozenset()
        return self.steps


def certificate_passport(collimator: CollimatorConfig, certificate: CertificateConfig) -> Passport:
    """Return the passport that a station's certificate stands for."""
    stated: Mapping[str, Any] = {
        "certificate": certificate.number,
        "issued": certificate.date and certificate.date.isoformat(),
        "valid_until": certificate.valid_until and certificate.valid_until.isoformat(),
        "collimator": collimator.serial,
        "temperature_c": certificate.temperature_c,
    }
    known = {key: value for key, value in stated.items() if value is not None}
    return Passport.of_radius(certificate.r_mm, certificate.sigma_mm, known, certificate.length or "")


def choose_passport(
    sequence: Located[Sequence],
    station: Located[OfflineStation],
    steps: tuple[Step, ...],
    *,
    copy: Path | None,
    today: date,
) -> PassportChoice:
    """Find, read and check the passport of the solve steps; ``copy``, of a run that has begun, goes first."""
    named = {step.number: _named(sequence, station, step) for step in steps if isinstance(step, SolveStep)}
    used = {number: passport for number, passport in named.items() if passport is not None}
    if not used:
        return PassportChoice()
    first, *others = dict.fromkeys(used.values())
    if others:
        fault = others[0].fault("the solve steps use different passports; a run uses one.")
        return PassportChoice(faults=(fault,))
    return _checked(first, station.value.collimator, frozenset(used), copy, today)


def station_passport(station: Located[OfflineStation], today: date) -> PassportChoice:
    """Read and check the passport or certificate that a station states, for files that are of no run."""
    named = _of_station(station, other_accepted=False)
    if named is None:
        return PassportChoice()
    return _checked(named, station.value.collimator, frozenset(), None, today)


def _checked(
    first: _Named, collimator: CollimatorConfig, used: frozenset[int], copy: Path | None, today: date
) -> PassportChoice:
    """Read the named passport of the steps ``used``, and judge whether it suits the collimator and the day."""
    try:
        in_use = first.read(copy)
    except BenchError as error:
        return PassportChoice(steps=used, faults=(first.fault(str(error)),))
    differs = in_use.serial is not None and collimator.serial not in (None, in_use.serial)
    if differs and not in_use.other_accepted:
        message = (
            f"the passport belongs to the collimator {in_use.serial}; the station's is {collimator.serial}. Name the "
            "right passport, or accept this one: solve: {other_collimator: accept}."
        )
        return PassportChoice(in_use, used, (first.fault(message),))
    cautions = in_use.cautions(collimator, today)
    if copy is None:
        unknown = _unknown_seal(in_use)
        if collimator.unsealed_passport == "refuse" and (in_use.is_unsealed or unknown):
            what = unknown or "the passport is not sealed."
            message = (
                f"{what} The station refuses it (collimator: {{unsealed_passport: refuse}}). Seal it with"
                " `starbench passport show FILE --seal NEW`, or trust its key with `starbench keys trust`."
            )
            return PassportChoice(in_use, used, (first.fault(message),))
        cautions += [unknown] if unknown else []
    remarks = tuple(first.fault(caution) for caution in cautions)
    return PassportChoice(in_use, used, remarks=remarks)


def _unknown_seal(in_use: PassportInUse) -> str:
    """Return what is to say if this bench does not trust the key that sealed a passport; empty otherwise."""
    if in_use.seal is None:
        return ""
    from bench.evidence.signers import SIGNERS_FILE, read_signers

    try:
        trusted = read_signers(home_folder() / SIGNERS_FILE)
    except EvidenceError:
        trusted = []
    if any(signer.public_key == in_use.seal.public_key for signer in trusted):
        return ""
    return f"the passport is sealed by {in_use.seal.fingerprint}, a key that this bench does not trust."


@dataclass(frozen=True)
class _Named:
    """Where a document names a passport, and which."""

    document: Located[Any] = field(compare=False)
    path: DocumentPath = field(compare=False)
    source: PassportSource
    file: Path | None
    certificate: Passport | None = field(compare=False)
    other_accepted: bool = field(compare=False)

    def fault(self, message: str) -> Fault:
        return self.document.fault(self.path, message)

    def read(self, copy: Path | None) -> PassportInUse:
        """Read the copy if there is one, else the named file; raises UsageError or StorageError."""
        name = self.file.name if self.file else "certificate"
        path = self.file if copy is None else require_copy(copy)
        if path is None:
            assert self.certificate is not None
            data = passport_bytes(self.certificate)
            return PassportInUse(self.certificate, data, self.source, name, self.other_accepted)
        passport, data, seal = read_passport_file(path)
        return PassportInUse(passport, data, self.source, name, self.other_accepted, seal)


def _named(sequence: Located[Sequence], station: Located[OfflineStation], step: SolveStep) -> _Named | None:
    """Return the passport that the documents name for a solve step."""
    accepted = step.other_collimator == "accept"
    if step.passport == NO_PASSPORT:
        return None
    if step.passport is not None:
        path = setting_path(sequence, step.path, "passport", "solve")
        file = sequence.file_at(path, step.passport)
        return _Named(sequence, path, "sequence", file, None, accepted)
    return None if step.model in REFERENCE_MODELS else _of_station(station, other_accepted=accepted)


def _of_station(station: Located[OfflineStation], *, other_accepted: bool) -> _Named | None:
    """Return the passport file or the certificate that the station states."""
    collimator = station.value.collimator
    if collimator.passport is not None:
        path = ("collimator", "passport")
        file = station.file_at(path, collimator.passport)
        return _Named(station, path, "station", file, None, other_accepted)
    if isinstance(collimator.certificate, CertificateConfig):
        made = certificate_passport(collimator, collimator.certificate)
        return _Named(
            station, ("collimator", "certificate"), "station certificate", None, made, other_accepted
        )
    return None


def _text(value: Any) -> str | None:
    """Return a stated fact as text; a passport is written by people too."""
    return None if value is None or value == "" else str(value)


def _date(value: Any) -> date | None:
    try:
        return date.fromisoformat(str(value))
    except ValueError:
        return None
