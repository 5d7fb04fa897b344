r"""A certificate as a digital calibration certificate (DCC): PTB's DCC 3.2.1 with D-SI 2.1.0.

`render_dcc` writes what the certificate states and nothing else: the same certificate gives the same bytes. It touches
no file, no clock and no schema. Who, what, for whom and the statements stand in `dcc_parties`; methods, conditions
and numbers are here.

Structure and order of the elements follow the schema https://ptb.de/dcc/v3.2.1/dcc.xsd; its content follows ISO/IEC
17025:2017, 7.8. Lengths in the image have the unit ``\one``, because D-SI has no pixel; a
statement defines the pixel.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from scipy.special import chdtri, fdtri, ndtr

from bench.certificate.certificate_data import Budget, BudgetRow, Certificate, Condition, Result, Traceability
from bench.certificate.dcc_parties import (
    CAMERA_ID,
    LENS_ID,
    PIXEL_ID,
    SUPPLIED_ID,
    add_items,
    add_laboratory,
    add_people,
    add_statements,
    result_id,
)
from bench.certificate.dcc_words import (
    BUDGET,
    COMBINED,
    CONTRIBUTION,
    DEGREES_OF_FREEDOM,
    EARLIER,
    JOINT,
    REF_TYPES,
    STATISTIC,
    add_number,
    add_real,
    add_software,
    add_text,
    add_words,
    d_si_unit,
    identifications,
    joined,
    number_text,
    plain_number,
    product,
    software_of,
    token,
)
from bench.certificate.dcc_xml import (
    DCC,
    LANGUAGE,
    NAMESPACES,
    ROOT,
    STARBENCH,
    VERSIONS,
    Versions,
    add,
    library,
    to_bytes,
)

if TYPE_CHECKING:
    from lxml.etree import _Element


GUM = "JCGM 100:2008"
_K_DIGITS = 4
_RANGE = re.compile(r"(-?\d+(?:\.\d+)?) to (-?\d+(?:\.\d+)?) (\S+)")


def add_measurement(parent: _Element, certificate: Certificate) -> None:
    """Add the measurement with its results."""
    one = add(parent, "dcc:measurementResult", refId=f"{CAMERA_ID} {LENS_ID}")
    add_text(one, "dcc:name", certificate.title)
    _add_methods(one, certificate)
    if used := software_of(certificate)[0]:
        add_software(add(one, "dcc:usedSoftware"), used)
    if certificate.traceability:
        equipment = add(one, "dcc:measuringEquipments")
        for reference in certificate.traceability:
            _add_reference(equipment, reference)
    if certificate.conditions:
        conditions = add(one, "dcc:influenceConditions")
        for condition in certificate.conditions:
            _add_condition(conditions, condition)
    results = add(one, "dcc:results")
    data = _result(results, "Interior orientation and distortion of the camera")
    for result in certificate.results:
        _add_result(data, result)
    _add_covariance(results, certificate)
    if certificate.further:
        data = _result(results, "Projection uncertainty and residuals")
        for further in certificate.further:
            add_number(data, further.name, further.value, further.unit, STATISTIC)
    for budget in certificate.budgets:
        _add_budget(results, budget)
    _add_earlier(results, certificate)


def _result(parent: _Element, name: str, description: str = "", ref_id: str | None = None) -> _Element:
    """Add a result and return its data."""
    one = add(parent, "dcc:result", refId=ref_id)
    add_text(one, "dcc:name", name)
    if description:
        add_text(one, "dcc:description", description)
    return add(one, "dcc:data")


def _add_methods(parent: _Element, certificate: Certificate) -> None:
    methods, method = add(parent, "dcc:usedMethods"), certificate.method
    one = add(methods, "dcc:usedMethod")
    add_text(one, "dcc:name", f"{method.id}, version {method.version}")
    add_text(one, "dcc:description", method.text)
    add(one, "dcc:reference", token(f"{method.id} {method.version}"))
    one = add(methods, "dcc:usedMethod", refType="basic_methodMeasurementUncertainty")
    add_text(one, "dcc:name", "Measurement uncertainty")
    text = certificate.statement("uncertainty") or "Expanded uncertainty, see each result."
    add_text(one, "dcc:description", text)
    add(one, "dcc:norm", GUM)


def _add_reference(parent: _Element, reference: Traceability) -> None:
    """Add a reference with its certificate as measuring equipment."""
    one = add(parent, "dcc:measuringEquipment")
    add_text(one, "dcc:name", reference.what)
    words = [reference.statement] if reference.statement else []
    if reference.number:
        words.append(
            f"Certificate {reference.number}"
            + (f" of {reference.issuer}" if reference.issuer else "")
            + (f", {reference.date}" if reference.date else "")
        )
        words += (
            [] if reference.sha256 else ["The file of the certificate is not at hand, so it has no hash here"]
        )
    if words:
        add_text(one, "dcc:description", joined(*words))
    if reference.number and reference.sha256:
        certificate = add(one, "dcc:certificate")
        stated = ", ".join(filter(None, (reference.issuer, reference.date)))
        add_text(certificate, "dcc:referral", f"Calibration certificate{f' ({stated})' if stated else ''}")
        add(certificate, "dcc:referralID", token(reference.number))
        add(certificate, "dcc:procedure", "SHA-256")
        add(certificate, "dcc:value", token(reference.sha256))
    identifications(one, ("calibrationLaboratory", reference.number, "Number of the certificate"))
    unit = d_si_unit(reference.unit)
    if reference.value is not None and unit is not None:
        quantity = add(add(one, "dcc:measuringEquipmentQuantities"), "dcc:measuringEquipmentQuantity")
        add_text(quantity, "dcc:name", reference.what)
        add_real(quantity, number_text(reference.value), unit, expanded=_expanded(reference.U, reference.k))


def _add_condition(parent: _Element, condition: Condition) -> None:
    """Add a condition: its number or the ends of its range if D-SI has the unit, else words."""
    name, unit = condition.name.lower(), d_si_unit(condition.unit)
    humidity = "basic_humidityRelative" if "humidity" in name else None
    one = add(
        parent, "dcc:influenceCondition", refType="basic_temperature" if "temperature" in name else humidity
    )
    add_text(one, "dcc:name", condition.name)
    words = condition.text if _RANGE.fullmatch(condition.text) else ""
    add_text(one, "dcc:description", joined(f"Source: {condition.source}", words))
    data = add(one, "dcc:data")
    limits = _RANGE.fullmatch(condition.text) if condition.value is None and unit is not None else None
    if limits is not None and unit is not None and limits[3] == condition.unit:
        for end, value in (("lowest", limits[1]), ("highest", limits[2])):
            quantity = add(data, "dcc:quantity")
            add_text(quantity, "dcc:name", f"{condition.name}, {end}")
            add_real(quantity, value, unit)
        return
    if condition.value is None or unit is None:
        value = "" if condition.value is None else f"{number_text(condition.value)} {condition.unit}"
        uncertainty = "" if condition.U is None or not value else f", U = {number_text(condition.U)}"
        add_text(data, "dcc:text", joined(value + uncertainty, condition.text))
        return
    quantity = add(data, "dcc:quantity")
    add_text(quantity, "dcc:name", condition.name)
    add_real(quantity, number_text(condition.value), unit, expanded=_expanded(condition.U, condition.k))


def _expanded(U: float | None, k: float | None) -> tuple[str, ...]:
    """Return an expanded uncertainty for ``si:real``. A normal distribution gives its probability."""
    if U is None or k is None:
        return ()
    probability = 2.0 * float(ndtr(k)) - 1.0
    return (number_text(U), plain_number(k, _K_DIGITS), plain_number(probability, _K_DIGITS), "normal")


def _add_result(parent: _Element, result: Result) -> None:
    """Add a result as printed, with its expanded uncertainty and effective degrees of freedom."""
    references = [PIXEL_ID] if "px" in result.unit else []
    references += [SUPPLIED_ID] if result.customer_supplied else []
    quantity = add(
        parent,
        "dcc:quantity",
        id=result_id(result.symbol),
        refId=" ".join(references) or None,
        refType="basic_measuredValue",
    )
    add_text(quantity, "dcc:name", result.name)
    add_text(quantity, "dcc:description", f"{result.symbol} = {result.text}")
    distribution = "normal" if result.nu_eff is None else "Student's t with the effective degrees of freedom"
    add_real(
        quantity,
        result.printed_value,
        unit_of(result.unit),
        label=result.symbol,
        expanded=(
            result.printed_uncertainty,
            plain_number(result.k, _K_DIGITS),
            plain_number(result.p, _K_DIGITS),
            distribution,
        ),
    )
    if result.nu_eff is not None:
        meta = add(add(quantity, "dcc:measurementMetaData"), "dcc:metaData", refType=DEGREES_OF_FREEDOM)
        add_text(meta, "dcc:name", "Effective degrees of freedom")
        add_number(add(meta, "dcc:data"), "nu_eff", round(result.nu_eff, 2), "1", DEGREES_OF_FREEDOM)


def unit_of(unit: str) -> str:
    """Return the unit of a result in D-SI's notation.

    Raises ValueError: When D-SI does not have it.
    """
    written = d_si_unit(unit)
    if written is None:
        raise ValueError(f"D-SI has no unit {unit!r}")
    return written


def _add_covariance(parent: _Element, certificate: Certificate) -> None:
    """Add all results, unrounded, as one list with the covariance matrix."""
    covariance = certificate.covariance
    if not covariance.names:
        return
    by_symbol = {one.symbol: one for one in certificate.results}
    members = [by_symbol[name] for name in covariance.names]
    units = [unit_of(unit) for unit in covariance.units]
    data = _result(
        parent,
        "Joint covariance of the results",
        "All results, unrounded, with their covariance matrix. Programs that compute with the results take this list.",
    )
    quantity = add(
        data, "dcc:quantity", refId=" ".join(result_id(name) for name in covariance.names), refType=JOINT
    )
    add_text(quantity, "dcc:name", "Results and covariance")
    several = add(quantity, "si:realListXMLList")
    add(several, "si:labelXMLList", " ".join(covariance.names))
    add(several, "si:valueXMLList", " ".join(number_text(one.value) for one in members))
    add(several, "si:unitXMLList", " ".join(units) if len(set(units)) > 1 else units[0])
    region = add(several, "si:ellipsoidalRegionXMLList")
    matrix = add(region, "si:covarianceMatrix")
    for column in range(len(units)):
        one = add(matrix, "si:column")
        for row in range(len(units)):
            element = add(one, "si:covariance")
            add(element, "si:value", number_text(covariance.matrix[row][column]))
            add(element, "si:unit", product(units[row], units[column]))
    p = min(one.p for one in members)
    nu = min((one.nu_eff for one in members if one.nu_eff is not None), default=None)
    add(region, "si:coverageFactor", plain_number(ellipsoid_factor(len(units), p, nu), _K_DIGITS))
    add(region, "si:coverageProbability", plain_number(p, _K_DIGITS))
    add(region, "si:distribution", "normal" if nu is None else f"multivariate t, {nu:.4g} degrees of freedom")


def ellipsoid_factor(n: int, p: float, nu: float | None) -> float:
    """Return the coverage factor of an ellipsoidal region (JCGM 102:2011, 6.5).

    With the multivariate t distribution (JCGM 102:2011, 5.3.2) the squared factor over n has an F distribution with n
    and nu degrees of freedom (Kotz and Nadarajah, Multivariate t Distributions and Their Applications, 2004).

    nu: Degrees of freedom; None for the normal distribution.

    Examples
    --------
    >>> round(ellipsoid_factor(2, 0.95, None), 3), round(ellipsoid_factor(1, 0.95, 10.0), 3)
    (2.448, 2.228)
    """
    if nu is None:
        return math.sqrt(chdtri(n, 1.0 - p))
    return math.sqrt(n * fdtri(n, nu, p))


def _add_budget(parent: _Element, budget: Budget) -> None:
    """Add the uncertainty budget of a result: one list a row."""
    text = " ".join(budget.remarks)
    data = _result(parent, f"Uncertainty budget of {budget.symbol}", text, ref_id=result_id(budget.symbol))
    for row in budget.rows:
        _add_budget_row(add(data, "dcc:list"), row, budget.unit)
    total = add(data, "dcc:list")
    add_text(total, "dcc:name", "Combined")
    add_number(total, COMBINED, budget.u, budget.unit, BUDGET)
    if budget.nu_eff is not None:
        add_number(total, "effective degrees of freedom", budget.nu_eff, "1", BUDGET)
    add_number(total, "coverage factor k", budget.k, "1", BUDGET)
    add_number(total, "expanded uncertainty U", budget.U, budget.unit, BUDGET)


def _add_budget_row(parent: _Element, row: BudgetRow, unit: str) -> None:
    add_text(parent, "dcc:name", row.name)
    certificate = ", ".join(
        filter(None, (row.number, row.date, f"SHA-256 {row.sha256}" if row.sha256 else ""))
    )
    source = f"Source: {row.source}" + (f"; certificate {certificate}" if certificate else "")
    add_text(
        parent,
        "dcc:description",
        f"Type {row.type}, {row.distribution or 'distribution not stated'}. {source}",
    )
    for name, value, its_unit in (
        ("stated value", row.value, row.unit),
        ("divisor", row.divisor, "1"),
        ("sensitivity", row.sensitivity, row.sensitivity_unit),
        (CONTRIBUTION, row.u, unit),
        ("share of the variance", row.share, "1"),
        ("degrees of freedom", row.nu, "1"),
    ):
        if value is not None:
            add_number(parent, name, value, its_unit, BUDGET)


def _add_earlier(parent: _Element, certificate: Certificate) -> None:
    """Add the calibration before this one (ISO/IEC 17025, 7.8.4.1 d)."""
    earlier = certificate.before_adjustment
    if earlier is None:
        return
    text = ", ".join(
        filter(
            None,
            (
                earlier.text,
                earlier.number,
                earlier.date,
                f"SHA-256 {earlier.sha256}" if earlier.sha256 else "",
            ),
        )
    )
    data = _result(parent, "Calibration before this one", text)
    for value in earlier.values:
        one = add(
            data, "dcc:list", refId=result_id(value.symbol) if value.symbol in _symbols(certificate) else None
        )
        add_text(one, "dcc:name", value.symbol)
        add_number(one, "value", value.value, value.unit, EARLIER)
        if value.U is not None:
            add_number(one, "expanded uncertainty as stated there", value.U, value.unit, EARLIER)
    for name, change in (
        ("RMS change of the projection", earlier.change_rms_px),
        ("largest change of the projection", earlier.change_largest_px),
    ):
        if change is not None:
            add_number(data, name, change, "px", STATISTIC)
    if not earlier.values and earlier.change_rms_px is None and earlier.change_largest_px is None:
        add_words(data, "values", "not known", EARLIER)


def _symbols(certificate: Certificate) -> set[str]:
    return {one.symbol for one in certificate.results}


def render_dcc(certificate: Certificate, versions: Versions = VERSIONS[0]) -> bytes:
    """Return a certificate as a digital calibration certificate, not signed.

    versions: Version of the DCC and of D-SI, one of `dcc_xml.VERSIONS`.
    Raises UsageError: When lxml is not installed.
    Raises ValueError: When the pair of versions is not one of `dcc_xml.VERSIONS`.
    """
    if versions not in VERSIONS:
        raise ValueError(f"DCC {versions.dcc} with D-SI {versions.si} cannot be written")
    etree = library("lxml.etree")
    root: _Element = etree.Element(
        ROOT,
        {
            f"{{{NAMESPACES['xsi']}}}schemaLocation": f"{DCC} {DCC}/v{versions.dcc}/dcc.xsd",
            "schemaVersion": versions.dcc,
        },
        nsmap={prefix: NAMESPACES[prefix] for prefix in ("dcc", "si", "xsi")},
    )
    administrative = add(root, "dcc:administrativeData")
    used, writers = software_of(certificate)
    starbench = [one for one in used if one.name == "starbench"]
    add_software(add(administrative, "dcc:dccSoftware"), [*starbench, *writers] or used)
    _add_ref_types(administrative)
    _add_core_data(administrative, certificate)
    add_items(administrative, certificate)
    add_laboratory(administrative, certificate)
    add_people(administrative, certificate)
    add_statements(administrative, certificate)
    add_measurement(add(root, "dcc:measurementResults"), certificate)
    _add_comment(root, certificate)
    etree.indent(root, space=" ")
    return to_bytes(root)


def _add_ref_types(parent: _Element) -> None:
    """Add what the refTypes of Starbench mean."""
    definitions = add(parent, "dcc:refTypeDefinitions")
    for name, meaning in REF_TYPES.items():
        one = add(definitions, "dcc:refTypeDefinition", refType=name)
        add_text(one, "dcc:name", name)
        add_text(one, "dcc:description", meaning)
        add(one, "dcc:namespace", "starbench")
        add(one, "dcc:link", STARBENCH)


def _add_core_data(parent: _Element, certificate: Certificate) -> None:
    """Add numbers, dates and place; for an amendment the certificate that it replaces."""
    core, run, amends = add(parent, "dcc:coreData"), certificate.run, certificate.amends
    add(core, "dcc:countryCodeISO3166_1", certificate.laboratory.address.country)
    add(core, "dcc:usedLangCodeISO639_1", LANGUAGE)
    add(core, "dcc:mandatoryLangCodeISO639_1", LANGUAGE)
    add(core, "dcc:uniqueIdentifier", token(certificate.number))
    ledger = "" if run.ledger_number is None else str(run.ledger_number)
    identifications(
        core,
        ("calibrationLaboratory", run.id, "Name of the run"),
        ("calibrationLaboratory", ledger, "Number of the run in the laboratory's ledger"),
    )
    if certificate.received:
        add(core, "dcc:receiptDate", certificate.received[:10])
    add(core, "dcc:beginPerformanceDate", certificate.begun_utc[:10])
    add(core, "dcc:endPerformanceDate", certificate.ended_utc[:10])
    add(core, "dcc:performanceLocation", certificate.laboratory.place_kind)
    add(core, "dcc:issueDate", certificate.issued_utc[:10])
    if amends is not None:
        replaced = add(core, "dcc:reportAmendedSubstituted")
        add(replaced, "dcc:typeOfChange", "amended")
        add(replaced, "dcc:replacedUniqueIdentifier", token(amends.number))
        previous = add(core, "dcc:previousReport")
        add_text(previous, "dcc:referral", "SHA256SUMS of the certificate that this one replaces")
        add(previous, "dcc:referralID", token(amends.number))
        add(previous, "dcc:procedure", "SHA-256")
        add(previous, "dcc:value", token(amends.sha256))
        add_text(previous, "dcc:description", f"Reason of the amendment: {amends.reason}")


def _add_comment(parent: _Element, certificate: Certificate) -> None:
    """Add the sealed run that the certificate comes from, for programs."""
    run = certificate.run
    comment = add(parent, "dcc:comment")
    etree = library("lxml.etree")
    provenance: _Element = etree.SubElement(comment, f"{{{STARBENCH}}}run", nsmap={"starbench": STARBENCH})
    provenance.set("simulated", "true" if certificate.simulated else "false")
    for name, value in (
        ("id", run.id),
        ("ledgerNumber", "" if run.ledger_number is None else str(run.ledger_number)),
        ("ledgerHead", run.ledger_head),
        ("journalHead", run.journal_head),
        ("sealSHA256", run.seal_sha256),
        ("resultsSHA256", run.results_sha256),
        ("signer", run.signer),
        ("signerFingerprint", run.signer_fingerprint),
        ("begun", certificate.begun_utc),
        ("ended", certificate.ended_utc),
        ("issued", certificate.issued_utc),
        ("authorisingKey", certificate.authorised_by.key_fingerprint),
    ):
        if value:
            add(provenance, f"starbench:{name}", value)
