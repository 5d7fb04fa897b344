"""From results.json and lab.yaml to a certificate. Same input, same certificate: no clock, no file, no key.

So a verifier can compose the certificate again from the two files in its folder and compare every byte.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.certificate import run_facts
from bench.certificate.budget_rows import RowSource, budget_of
from bench.certificate.certificate_data import (
    FORMAT,
    Accreditation,
    Address,
    Amends,
    AuthorisedBy,
    BeforeAdjustment,
    Certificate,
    Condition,
    Contact,
    Customer,
    Deviation,
    Item,
    Laboratory,
    Lens,
    Method,
    Result,
    Run,
    Traceability,
    ValueBefore,
)
from bench.certificate.conformity import conformity_of
from bench.certificate.lab_config import (
    NONE,
    AccreditationConfig,
    AddressConfig,
    ConditionConfig,
    ContactConfig,
    LabConfig,
    PreviousConfig,
    SourceConfig,
)
from bench.certificate.number_format import SIMULATED
from bench.certificate.statements import statements_of
from bench.records.results import Results
from bench.report.target_words import words_of
from calib.model.budget_row import PASSPORT


@dataclass(frozen=True)
class Identity:
    """What makes this certificate this one: everything that neither the run's results nor lab.yaml can give."""

    number: str
    issued_utc: str
    run: Run
    amends: Amends | None = None  # The certificate that this one replaces, if any
    also: str = ""  # Why a second certificate is issued for the run; empty if it is the first one
    verified: str = ""  # What was verified before the issue, in words


def compose(found: Results, lab: LabConfig, identity: Identity) -> Certificate:
    """Return the certificate of a run. Every clause is answered, and nothing contradicts the run (checked before).

    Raises EvidenceError: When the uncertainty budget is missing or does not add up.
    """
    simulated = bool(found["run"]["simulated"])
    supplied = frozenset(symbol for one in lab.customer_supplied or () for symbol in one.results)
    results = run_facts.results_of(found, supplied)
    rows = row_sources(found, lab)
    return Certificate(
        format=FORMAT,
        language="en",
        title=f"SIMULATED {lab.title[0].lower()}{lab.title[1:]}" if simulated else lab.title,
        number=identity.number,
        series=(SIMULATED if simulated else "") + lab.numbers.format,
        simulated=simulated,
        laboratory=_laboratory(lab),
        customer=Customer(
            lab.customer.name or "", _contact(lab.customer.contact), _address(lab.customer.address)
        ),
        item=_item(found, lab),
        received=lab.item.received.isoformat() if lab.item.received else "",
        begun_utc=run_facts.utc_seconds(found["run"]["started_utc"]),
        ended_utc=run_facts.utc_seconds(found["run"]["finished_utc"]),
        issued_utc=identity.issued_utc,
        method=Method(lab.method.id, lab.method.version, lab.method.text)
        if lab.method
        else Method("", "", ""),
        deviations=(
            *run_facts.deviations_of(found),
            *(Deviation(text, "laboratory") for text in lab.deviations or ()),
        ),
        conditions=(*run_facts.conditions_of(found), *(_condition(one) for one in lab.conditions or ())),
        traceability=_traceability(found, lab),
        results=results,
        covariance=run_facts.covariance_of(found),
        further=run_facts.further_of(found),
        budgets=tuple(
            budget_of(found["calibration"], one.symbol, one.unit, rows, one.U, words_of(found))
            for one in results
        ),
        before_adjustment=_before(found, lab),
        conformity=tuple(
            conformity_of(rule, _named(results, rule.result)) for rule in lab.decision_rules or ()
        ),
        customer_supplied=tuple(one.text for one in lab.customer_supplied or ()),
        external=lab.external or (),
        opinions=lab.opinions,
        authorised_by=(
            AuthorisedBy(lab.authorised_by.name, lab.authorised_by.role, lab.authorised_by.key)
            if lab.authorised_by
            else AuthorisedBy("", "", "")
        ),
        run=identity.run,
        amends=identity.amends,
        statements=statements_of(found, lab, also=identity.also, verified=identity.verified),
    )


def row_sources(found: Results, lab: LabConfig) -> dict[str, RowSource]:
    """Return the certificates behind the rows of the budget: what the run states, then what lab.yaml adds."""
    sources = {}
    if in_run := found.get("passport"):
        value, divisor = _radius_uncertainty(found, in_run)
        sources[PASSPORT] = RowSource(
            str(in_run.get("number") or ""),
            str(in_run.get("date") or ""),
            str(in_run.get("sha256") or ""),
            value if set(in_run.get("values") or {}) == {"r"} else None,
            divisor,
            "mm",
        )
    for one in lab.sources:
        if one.row is None:
            continue
        known = sources.get(one.row, RowSource())
        sources[one.row] = replace(
            known,
            number=one.number or known.number,
            date=one.date.isoformat() if one.date else known.date,
            sha256=one.sha256 or known.sha256,
        )
    return sources


def _laboratory(lab: LabConfig) -> Laboratory:
    stated = lab.laboratory.accreditation
    return Laboratory(
        name=lab.laboratory.name or "",
        address=_address(lab.laboratory.address),
        contact=_contact(lab.laboratory.contact),
        accreditation=(
            Accreditation(stated.body, stated.number, stated.scope)
            if isinstance(stated, AccreditationConfig)
            else None
        ),
        place_kind=lab.place.kind if lab.place else "other",
        place=lab.place.name if lab.place else "",
    )


def _address(one: AddressConfig | None) -> Address:
    if one is None:
        return Address("", "", "", "")
    return Address(one.street or "", one.post_code or "", one.city, one.country)


def _contact(one: ContactConfig | None) -> Contact:
    return Contact("", "", "") if one is None else Contact(one.name or "", one.email or "", one.phone or "")


def _item(found: Results, lab: LabConfig) -> Item:
    lens = lab.item.lens
    return Item(
        camera=run_facts.camera_identity(found, lab.item),
        lens=Lens(
            maker=lens.maker or "",
            model=lens.model or "",
            serial="" if lens.serial in (None, NONE) else str(lens.serial),
            focus=lens.focus or "",
            aperture=lens.aperture or "",
            focus_locked=bool(lens.focus_locked),
            aperture_locked=bool(lens.aperture_locked),
        ),
        customer_id=lab.item.customer_id or "",
        condition=lab.item.condition or "",
    )


def _condition(one: ConditionConfig) -> Condition:
    if one.value is None:
        return Condition(one.name, None, "1", None, None, one.text or "", one.instrument or "laboratory")
    certificate = f", certificate {one.certificate}" if one.certificate else ""
    return Condition(
        one.name,
        one.value,
        one.unit or "1",
        one.uncertainty,
        one.k if one.uncertainty is not None else None,
        "",
        f"{one.instrument}{certificate}",
    )


def _traceability(found: Results, lab: LabConfig) -> tuple[Traceability, ...]:
    """Return the collimator's certificate or passport, then the other references of lab.yaml."""
    by_row = {one.row: one for one in lab.sources}
    rows = []
    if in_run := found.get("passport"):
        rows.append(_collimator(found, in_run, by_row.get(PASSPORT)))
    rows += [
        Traceability(
            what=one.what or one.row or "",
            value=None,
            U=None,
            k=None,
            unit="1",
            number=one.number or "",
            issuer=one.issuer or "",
            date=one.date.isoformat() if one.date else "",
            sha256=one.sha256 or "",
            statement=one.statement or "",
        )
        for one in lab.sources
        if not (in_run and one.row == PASSPORT)
    ]
    return tuple(rows)


def _collimator(found: Results, in_run: Mapping[str, Any], stated: SourceConfig | None) -> Traceability:
    radius = (in_run.get("values") or {}).get("r")
    expanded, k = _radius_uncertainty(found, in_run)
    source = RowSource(
        str(in_run.get("number") or (stated and stated.number) or ""),
        str(in_run.get("date") or (stated and stated.date and stated.date.isoformat()) or ""),
        (stated and stated.sha256) or str(in_run.get("sha256") or ""),
    )
    return Traceability(
        what=(stated and stated.what) or "focal length of the collimator",
        value=None if radius is None else float(radius),
        U=expanded,
        k=k,
        unit="mm",
        number=source.number,
        issuer=(stated and stated.issuer) or "",
        date=source.date,
        sha256=source.sha256,
        statement=(stated and stated.statement) or "",
    )


def _radius_uncertainty(found: Results, in_run: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the uncertainty of the collimator's focal length as it is stated, mm, and its coverage factor."""
    certificate = (found["run"].get("collimator") or {}).get("certificate")
    if isinstance(certificate, Mapping) and in_run.get("source") == "station certificate":
        return float(certificate["uncertainty_mm"]), float(certificate.get("k", 2.0))
    sigma = (in_run.get("sigma") or {}).get("r")
    return (None, None) if sigma is None else (float(sigma), 1.0)


def _before(found: Results, lab: LabConfig) -> BeforeAdjustment | None:
    """Return the calibration before this one: the certificate of lab.yaml, and the last run on this bench."""
    earlier: Mapping[str, Any] = found.get("previous") or {}
    stated = lab.previous_certificate
    known = isinstance(stated, PreviousConfig)
    if not known and not earlier.get("run"):
        return None
    texts: list[str] = []
    values: tuple[ValueBefore, ...] = ()
    change = earlier.get("change") or {}
    number = date = digest = ""
    if isinstance(stated, PreviousConfig):
        number, date, digest = stated.number, stated.date.isoformat(), stated.sha256 or ""
        texts.append(f"Certificate {number} of {date}" + (f", {stated.issuer}" if stated.issuer else ""))
    if earlier.get("run"):
        texts.append(
            f"Calibration of this camera on this bench in run {earlier['run']} (number {earlier.get('number')}), ended"
            f" {earlier.get('finished_utc') or 'at an unknown time'}; seal SHA-256 {earlier.get('seal')}"
        )
        then = earlier["calibration"]
        k = float(then["coverage_factor"])
        values = tuple(
            ValueBefore(name, float(value), float(f"{k * then['sigma'][name]:.9g}"), run_facts.unit_of(name))
            for name, value in then["camera"].items()
        )
    return BeforeAdjustment(
        "; ".join(texts),
        number,
        date,
        digest,
        values,
        None if "rms_px" not in change else float(change["rms_px"]),
        None if "largest_px" not in change else float(change["largest_px"]),
    )


def _named(results: Sequence[Result], symbol: str) -> Result:
    return next(one for one in results if one.symbol == symbol)
