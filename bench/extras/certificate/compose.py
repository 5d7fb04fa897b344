"""From results.json and lab.yaml to a certificate. Same input, same certificate: no clock, no file, no key.

The guard band is the expanded uncertainty, w = U (ILAC-G8:09/2019, 4.2.2 and 4.2.3); the decision uses the printed
numbers, so that a reader can repeat it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from bench.extras.certificate import facts_of_run
from bench.extras.certificate.budget_rows import RowSource, budget_of
from bench.extras.certificate.certificate_data import (
    FORMAT,
    Amends,
    BeforeAdjustment,
    Certificate,
    Condition,
    Conformity,
    Deviation,
    Item,
    Laboratory,
    Result,
    Run,
    Statement,
    Traceability,
    ValueBefore,
)
from bench.extras.certificate.facts_of_run import is_unnamed
from bench.extras.certificate.lab_config import (
    NONE,
    Accreditation,
    ConditionConfig,
    LabConfig,
    LabRuleConfig,
    PreviousConfig,
    SourceConfig,
)
from bench.extras.certificate.limits import despite_fail, rules_of
from bench.extras.certificate.series import SIMULATED
from bench.record.conformity import verdict_of
from bench.record.results import Results, StatedPassport
from bench.wording.earlier_runs import earlier_runs
from bench.wording.parameters import unit_of
from calib.model.lens import is_fisheye
from calib.model.result_parts import PASSPORT

_SIMULATED = (
    "SIMULATED: the devices of this calibration were simulated. This document shows the procedure; it is no calibration"
    " of a real camera."
)
_ITEMS = "The results relate only to the item calibrated, in the condition and with the settings described."
_READ_FROM_THE_ITEM = (
    "The camera does not report maker, model and serial number; the laboratory read them from the item."
)
_REPRODUCTION = (
    "This certificate shall not be reproduced except in full, unless the laboratory approves in writing."
)
_UNCERTAINTY = (
    "The expanded uncertainty U is the standard uncertainty u multiplied by the coverage factor k that is stated with"
    " each result: U = k u. By the distribution of the result, Student's t where the effective degrees of freedom are"
    " few, it corresponds to a coverage probability of about 95 %. The standard uncertainties were determined by"
    " JCGM 100 (GUM); the joint covariance is stated. For quantities that are calculated from several results, use"
    " the largest k. U has two significant digits and is rounded up, unless rounding down changes it by 1 % or less."
)
_ADJUSTMENT = "The item was calibrated as received. Nothing was adjusted or repaired."
_NOT_ACCREDITED = "This calibration is not covered by an accreditation."
_CUSTOMER_DATA = (
    "Data that the customer supplied are marked. They can affect the validity of results; the laboratory is not"
    " responsible for them."
)
_AUTHORISATION = (
    "This document is sealed by the calibration bench. It is authorised only with the signature of the person named,"
    " which lies beside the seal: SHA256SUMS.authorised.sig. Without it this document is not a valid certificate."
)
_BROWN = (
    "A point (X, Y, Z) in the frame of the camera has x = X / Z, y = Y / Z and r2 = x x + y y. With the radial factor"
    " L = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3) its image point is"
    " u = fx (L x + 2 p1 x y + p2 (r2 + 2 x x)) + cx and v = fy (L y + p1 (r2 + 2 y y) + 2 p2 x y) + cy, in pixels;"
    " the centre of the first pixel is (0, 0). Coefficients that are not listed are zero (Brown's model as in OpenCV)."
)
_SKEW = " To u, the skew times the factor of fy in v is added: K[0, 1] of the camera matrix, in pixels."
_FISHEYE = (
    "A point (X, Y, Z) in the frame of the camera has x = X / Z, y = Y / Z, r = sqrt(x x + y y) and the angle"
    " t = atan(r). With d = t (1 + kb1 t^2 + kb2 t^4 + kb3 t^6 + kb4 t^8) / r its image point is u = fx d x + cx and"
    " v = fy d y + cy, in pixels; the centre of the first pixel is (0, 0). Coefficients that are not listed are zero"
    " (model of Kannala and Brandt, OpenCV's fisheye model)."
)


FURTHER = "This is a further certificate of the same run. Reason: "
RULE = (
    "Decision rule: guard band w = U, the expanded uncertainty; the printed numbers count. pass: the value lies inside"
    " the limits by U or more. conditionalPass: inside the limits, but by less than U. conditionalFail: outside the"
    " limits, by U or less. fail: outside the limits by more than U. (ILAC-G8, guarded acceptance and rejection.)"
)

Part = TypeVar("Part")


def statements_of(results: Results, lab: LabConfig, identity: Identity) -> tuple[Statement, ...]:
    """Return the fixed texts in printed order."""
    calibration = results["calibration"]
    notes = " ".join(str(note) for note in calibration["notes"])
    left_out = "; ".join(str(line) for line in calibration["not_included"])
    pairs = [
        ("simulated", _SIMULATED if results["run"]["simulated"] else ""),
        ("limits", despite_fail(results) if identity.despite else ""),
        ("limits_reason", identity.despite),
        ("authorisation", _AUTHORISATION),
        ("accreditation", _NOT_ACCREDITED if lab.laboratory.accreditation == NONE else ""),
        ("items", _ITEMS),
        ("identity", _READ_FROM_THE_ITEM if is_unnamed(results) else ""),
        ("reproduction", _REPRODUCTION),
        ("model", _model_of(calibration["camera"])),
        ("uncertainty", _UNCERTAINTY),
        ("notes", notes),
        ("not_included", f"Not known and not included in the uncertainty: {left_out}." if left_out else ""),
        ("traceability", lab.traceability or ""),
        ("verification", identity.verified),
        ("verdicts", identity.verdicts),
        ("earlier_runs", _earlier_runs(results)),
        ("adjustment", _ADJUSTMENT),
        ("customer_data", _CUSTOMER_DATA if lab.customer_supplied else ""),
        ("recalibration", f"Recalibration: {lab.recalibration}" if lab.recalibration else ""),
        ("also", identity.also),
    ]
    return tuple(Statement(name, text) for name, text in pairs if text)


def _earlier_runs(results: Results) -> str:
    """Return how often the camera was calibrated on this bench before, by the bench's ledger."""
    ledger = results["run"].get("ledger")
    if not ledger:
        return ""
    broken = " The ledger had a break that nobody had explained." if ledger.get("faults") else ""
    return f"Earlier runs of this camera on this bench, by its ledger: {earlier_runs(ledger)}.{broken}"


def _model_of(camera: Mapping[str, Any]) -> str:
    """Return the equations of a camera's model in words."""
    if is_fisheye(camera):
        return _FISHEYE
    return _BROWN + _SKEW if "skew" in camera else _BROWN


def conformity_of(rule: LabRuleConfig, result: Result) -> Conformity:
    """Return the statement of conformity of a result."""
    return Conformity(
        symbol=result.symbol,
        specification=rule.specification,
        lower=rule.lower,
        upper=rule.upper,
        unit=result.unit,
        guard_band=result.U,
        rule=RULE,
        verdict=verdict_of(result.printed_value, result.printed_uncertainty, rule.lower, rule.upper),
    )


@dataclass(frozen=True)
class Identity:
    """What makes this certificate this one: everything that neither the run's results nor lab.yaml can give."""

    number: str
    issued_utc: str
    run: Run
    amends: Amends | None = None  # The certificate that this one replaces, if any
    also: str = ""  # `FURTHER` and why the run has a second certificate; empty if it is the first one
    despite: str = ""  # Why it states a pass over a FAIL of the run; empty if it does not
    verified: str = ""  # What was verified before the issue, in words
    verdicts: str = ""  # How the runs of the camera were judged (`bench.extras.certificate.verdicts`)


def compose(sealed: Results, lab: LabConfig, identity: Identity) -> Certificate:
    """Return a run's certificate, its clauses checked before; `EvidenceError` if the budget does not add up."""
    simulated = bool(sealed["run"]["simulated"])
    by_customer = frozenset(symbol for supplied in lab.customer_supplied or () for symbol in supplied.results)
    results = facts_of_run.results_of(sealed, by_customer)
    rows = row_sources(sealed, lab)
    return Certificate(
        format=FORMAT,
        language="en",
        title=f"SIMULATED {lab.title[0].lower()}{lab.title[1:]}" if simulated else lab.title,
        number=identity.number,
        series=(SIMULATED if simulated else "") + lab.numbers.format,
        simulated=simulated,
        laboratory=_laboratory(lab),
        customer=lab.customer,
        item=_item(sealed, lab),
        received=_day(lab.item.received),
        begun_utc=facts_of_run.utc_seconds(sealed["run"]["started_utc"]),
        ended_utc=facts_of_run.utc_seconds(sealed["run"]["finished_utc"]),
        issued_utc=identity.issued_utc,
        method=_needed(lab.method),
        deviations=(
            *facts_of_run.deviations_of(sealed),
            *(Deviation(text, "laboratory") for text in lab.deviations or ()),
        ),
        conditions=(
            *facts_of_run.conditions_of(sealed),
            *(_condition(condition) for condition in lab.conditions or ()),
        ),
        traceability=_traceability(sealed, lab),
        results=results,
        covariance=facts_of_run.covariance_of(sealed),
        further=facts_of_run.further_of(sealed),
        budgets=tuple(
            budget_of(sealed["calibration"], result.symbol, result.unit, rows, result.U) for result in results
        ),
        before_adjustment=_before(sealed, lab),
        conformity=tuple(conformity_of(rule, _named(results, rule.result)) for rule in rules_of(sealed, lab)),
        customer_supplied=tuple(supplied.text for supplied in lab.customer_supplied or ()),
        external=lab.external or (),
        opinions=lab.opinions,
        authorised_by=_needed(lab.authorised_by),
        run=identity.run,
        amends=identity.amends,
        statements=statements_of(sealed, lab, identity),
    )


def row_sources(results: Results, lab: LabConfig) -> dict[str, RowSource]:
    """Return the certificates behind the rows of the budget: what the run states, then what lab.yaml adds."""
    sources = {}
    if in_run := results.get("passport"):
        value, divisor = _radius_uncertainty(results, in_run)
        sources[PASSPORT] = RowSource(
            in_run.number or "",
            in_run.date or "",
            in_run.sha256,
            value if set(in_run.values) == {"r"} else None,
            divisor,
            "mm",
        )
    for source in lab.sources:
        if source.row is None:
            continue
        known = sources.get(source.row, RowSource())
        sources[source.row] = replace(
            known,
            number=source.number or known.number,
            date=_day(source.date) or known.date,
            sha256=source.sha256 or known.sha256,
        )
    return sources


def _laboratory(lab: LabConfig) -> Laboratory:
    stated = lab.laboratory.accreditation
    return Laboratory(
        name=lab.laboratory.name,
        address=_needed(lab.laboratory.address),
        contact=_needed(lab.laboratory.contact),
        accreditation=stated if isinstance(stated, Accreditation) else None,
        place_kind=_needed(lab.place).kind,
        place=_needed(lab.place).name,
    )


def _needed(part: Part | None) -> Part:
    """Return a part of lab.yaml that a clause asks for, so that `clauses` has refused a file without it."""
    assert part is not None
    return part


def _day(date: dt.date | None) -> str:
    return date.isoformat() if date else ""


def _item(results: Results, lab: LabConfig) -> Item:
    lens = lab.item.lens
    return Item(
        camera=facts_of_run.camera_identity(results, lab.item),
        lens=lens.model_copy(update={"serial": ""}) if lens.serial == NONE else lens,
        customer_id=lab.item.customer_id,
        condition=lab.item.condition,
    )


def _condition(condition: ConditionConfig) -> Condition:
    if condition.value is None:
        return Condition(
            condition.name, None, "1", None, None, condition.text, condition.instrument or "laboratory"
        )
    certificate = f", certificate {condition.certificate}" if condition.certificate else ""
    return Condition(
        condition.name,
        condition.value,
        condition.unit,
        condition.uncertainty,
        condition.k if condition.uncertainty is not None else None,
        "",
        f"{condition.instrument}{certificate}",
    )


def _traceability(results: Results, lab: LabConfig) -> tuple[Traceability, ...]:
    """Return the collimator's certificate or passport, then the other references of lab.yaml."""
    by_row = {source.row: source for source in lab.sources}
    rows = []
    if in_run := results.get("passport"):
        rows.append(_collimator(results, in_run, by_row.get(PASSPORT)))
    rows += [
        _reference(source, source.what or source.row or "")
        for source in lab.sources
        if not (in_run and source.row == PASSPORT)
    ]
    return tuple(rows)


def _reference(source: SourceConfig, what: str) -> Traceability:
    """Return the certificate of a reference as lab.yaml states it, without a value."""
    return Traceability(
        what,
        None,
        None,
        None,
        "1",
        source.number,
        source.issuer,
        _day(source.date),
        source.sha256,
        source.statement,
    )


def _collimator(results: Results, in_run: StatedPassport, stated: SourceConfig | None) -> Traceability:
    """Return the certificate or passport of the collimator, of the run before that of lab.yaml."""
    radius = in_run.values.get("r")
    expanded, k = _radius_uncertainty(results, in_run)
    known = _reference(stated or SourceConfig(row=PASSPORT), "focal length of the collimator")
    return replace(
        known,
        what=(stated and stated.what) or known.what,
        value=None if radius is None else float(radius),
        U=expanded,
        k=k,
        unit="mm",
        number=in_run.number or known.number,
        date=in_run.date or known.date,
        sha256=known.sha256 or in_run.sha256,
    )


def _radius_uncertainty(results: Results, in_run: StatedPassport) -> tuple[float | None, float | None]:
    """Return the uncertainty of the collimator's focal length as it is stated, mm, and its coverage factor."""
    certificate = (results["run"].get("collimator") or {}).get("certificate")
    if isinstance(certificate, Mapping) and in_run.source == "station certificate":
        return float(certificate["uncertainty_mm"]), float(certificate.get("k", 2.0))
    sigma = in_run.sigma.get("r")
    return (None, None) if sigma is None else (float(sigma), 1.0)


def _before(results: Results, lab: LabConfig) -> BeforeAdjustment | None:
    """Return the calibration before this one: the certificate of lab.yaml, and the last run on this bench."""
    earlier, stated = results.get("previous"), lab.previous_certificate
    if earlier is None or not earlier["run"]:
        earlier = None
    if earlier is None and not isinstance(stated, PreviousConfig):
        return None
    texts: list[str] = []
    values: tuple[ValueBefore, ...] = ()
    change = earlier.get("change") if earlier else None
    number = date = digest = ""
    if isinstance(stated, PreviousConfig):
        number, date, digest = stated.number, stated.date.isoformat(), stated.sha256
        texts.append(f"Certificate {number} of {date}" + (f", {stated.issuer}" if stated.issuer else ""))
    if earlier is not None:
        texts.append(
            f"Calibration of this camera on this bench in run {earlier['run']} (number {earlier.get('number')}), ended"
            f" {earlier.get('finished_utc') or 'at an unknown time'}; seal SHA-256 {earlier.get('seal')}"
        )
        then = earlier["calibration"]
        k = float(then["coverage_factor"])
        values = tuple(
            ValueBefore(name, float(value), float(f"{k * then['sigma'][name]:.9g}"), unit_of(name))
            for name, value in then["camera"].items()
        )
    return BeforeAdjustment(
        "; ".join(texts),
        number,
        date,
        digest,
        values,
        change.rms_px if change else None,
        change.largest_px if change else None,
    )


def _named(results: Sequence[Result], symbol: str) -> Result:
    return next(result for result in results if result.symbol == symbol)
