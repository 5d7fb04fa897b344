r"""A certificate as a digital calibration certificate (DCC): PTB's DCC 3.2.1 with D-SI 2.1.0. Same input, same bytes.

`dcc.xml.j2` is the form; here are words from several fields, and numbers as D-SI wants them. The content follows
ISO/IEC 17025:2017, 7.8. Lengths in the image have the unit ``\one``: D-SI has no pixel; a statement defines it.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jinja2
from markupsafe import Markup, escape
from scipy.special import chdtri, fdtri, ndtr

from bench.base.encoding import plain_number
from bench.extras.certificate.certificate_data import (
    BudgetRow,
    Certificate,
    Condition,
    Result,
    Software,
    Traceability,
)
from bench.extras.certificate.d_si import d_si_unit, product
from bench.extras.certificate.dcc_xml import DCC_VERSION, NAMESPACES, library, printable, to_bytes
from bench.extras.certificate.sealed_run import FORM

if TYPE_CHECKING:
    from lxml.etree import _Element


GUM = "JCGM 100:2008"
NO_NUMBER = "not stated"
_K_DIGITS = 4  # As many decimals as p = 0.9545 has
_POSTERIOR = "posterior of the adjustment"
_NORMAL_WITHIN = 5e-4  # of the probability: k by 0.005
_RANGE = re.compile(r"(-?\d+(?:\.\d+)?) to (-?\d+(?:\.\d+)?) (\S+)")
_RELEASE = re.compile(r"\d{1,3}(?:\.\d{1,3}){0,3}(?![0-9A-Za-z])")
_PIXEL = (
    "One pixel is the distance between the centres of neighbouring pixels of the calibrated camera, along a row for x"
    " and along a column for y. The centre of the first pixel has the coordinates (0, 0). D-SI has no pixel, so"
    " numbers in pixels are stated with the unit one."
)
_STATEMENT_NAMES = {
    "simulated": "Simulated devices",
    "authorisation": "Authorisation",
    "items": "Validity",
    "reproduction": "Reproduction",
    "uncertainty": "Measurement uncertainty",
    "traceability": "Metrological traceability",
    "model": "Model of the camera",
    "verification": "Verification of the run",
    "adjustment": "Adjustment",
    "accreditation": "Accreditation",
    "customer_data": "Data of the customer",
    "recalibration": "Recalibration",
    "also": "Further information",
    "limits": "Limits of the laboratory beside those of the run",
    "limits_reason": "Reason for the limits of the laboratory",
    "verdicts": "Verdicts of the runs of the item",
    "earlier_runs": "Earlier runs of the item",
    "notes": "Notes on the results",
    "not_included": "Not included in the uncertainty",
}
_REF_TYPES = {
    "starbench_statistic": "A number that is itself an uncertainty or a residual; it has no uncertainty of its own.",
    "starbench_budgetEntry": "A number of an uncertainty budget.",
    "starbench_earlierValue": "A number of an earlier calibration, as stated there.",
    "starbench_effectiveDegreesOfFreedom": "Effective degrees of freedom of a result's uncertainty (JCGM 100, G.4).",
    "starbench_jointCovariance": "All results, unrounded, with their covariance matrix (JCGM 102).",
    "starbench_simulated": "States that devices were simulated: this is not a calibration of a real item.",
    "starbench_limit": "A limit of tolerance or a guard band of a statement of conformity.",
}
"""The refTypes of Starbench and their meanings. Those that begin with ``basic_`` are PTB's."""


def render_dcc(certificate: Certificate) -> bytes:
    """Return the DCC of a certificate, not signed; it needs lxml."""
    etree = library("lxml.etree")
    used, writers = _software_of(certificate)
    amends = certificate.amends
    changes = amends.changes if amends else ()
    filled = _form().render(
        c=certificate,
        version=DCC_VERSION,
        writers=[*(software for software in used if software.name == "starbench"), *writers] or used,
        programs=used,
        fixed={statement.id: statement.text for statement in certificate.statements},
        changed="; ".join(f"{change.field}: {change.before} -> {change.after}" for change in changes),
        joint=_joint(certificate) if certificate.covariance.names else None,
        provenance=_provenance(certificate),
    )
    root: _Element = etree.fromstring(filled, etree.XMLParser(remove_blank_text=True, resolve_entities=False))
    etree.indent(root, space=" ")
    return to_bytes(root)


@functools.cache
def _form() -> jinja2.Template:
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("bench.extras", "certificate"),
        autoescape=True,
        finalize=_escaped,
        undefined=jinja2.StrictUndefined,
    )
    made.filters |= {
        "d_si_unit": d_si_unit,
        "digits": number_text,
        "release": lambda version: release[0] if (release := _RELEASE.match(version)) else "",
        "token": lambda text: " ".join(text.split()) or "-",
        "unit": unit_of,
    }
    made.globals |= {
        "budget_entry": "starbench_budgetEntry",
        "expanded": _expanded,
        "gum": GUM,
        "in_words": _in_words,
        "is_range": _RANGE.fullmatch,
        "joined": joined,
        "limits_of": _limits,
        "no_number": NO_NUMBER,
        "ns": NAMESPACES,
        "pixel": _PIXEL,
        "product": product,
        "ref_types": _REF_TYPES,
        "reference_words": _reference_words,
        "row_words": _row_words,
        "as_printed": _as_printed,
        "statement_names": _STATEMENT_NAMES,
    }
    return made.get_template("dcc.xml.j2")


def _escaped(value: Any) -> Any:
    """Return a value of the form as XML can hold it; what the form itself made is that already."""
    if isinstance(value, Markup):
        return value
    return Markup(str(escape(printable(str(value)))).replace("\r", "&#13;"))  # noqa: S704 - escaped before


def _software_of(certificate: Certificate) -> tuple[list[Software], list[Software]]:
    """Return the programs of the run, and what wrote the certificate."""
    listed = list(certificate.run.software)
    at = next((at for at, software in enumerate(listed) if software.name == FORM), len(listed))
    return listed[:at], listed[at:]


def _reference_words(traceability: Traceability) -> str:
    words = [traceability.statement]
    if traceability.number:
        words.append(
            f"Certificate {traceability.number}"
            + (f" of {traceability.issuer}" if traceability.issuer else "")
            + (f", {traceability.date}" if traceability.date else "")
        )
        words += (
            []
            if traceability.sha256
            else ["The file of the certificate is not at hand, so it has no hash here"]
        )
    return joined(*words)


def _row_words(row: BudgetRow) -> str:
    """Return how a row of a budget was evaluated, and where it comes from."""
    certificate = ", ".join(
        filter(None, (row.number, row.date, f"SHA-256 {row.sha256}" if row.sha256 else ""))
    )
    source = f"Source: {row.source}" + (f"; certificate {certificate}" if certificate else "")
    return f"Type {row.type}, {row.distribution or 'distribution not stated'}. {source}"


def _limits(condition: Condition) -> dict[str, str]:
    """Return the ends of a range that is stated in words; empty if it is none, or D-SI does not have its unit."""
    limits = _RANGE.fullmatch(condition.text)
    if condition.value is not None or limits is None or limits[3] != condition.unit:
        return {}
    return {"lowest": limits[1], "highest": limits[2]} if d_si_unit(condition.unit) else {}


def _in_words(condition: Condition) -> str:
    """Return a condition that D-SI cannot state as a number."""
    value = "" if condition.value is None else f"{number_text(condition.value)} {condition.unit}"
    uncertainty = "" if condition.U is None or not value else f", U = {number_text(condition.U)}"
    return joined(value + uncertainty, condition.text)


def _expanded(U: float | None, k: float | None) -> dict[str, str] | None:
    """Return an expanded uncertainty. A normal distribution gives its probability."""
    if U is None or k is None:
        return None
    p = 2.0 * float(ndtr(k)) - 1.0
    return _uncertainty(number_text(U), k, p, "normal")


def _as_printed(result: Result) -> dict[str, str]:
    """Return the expanded uncertainty of a result as printed; k of a posterior need not be that of a normal one."""
    if result.nu_eff is not None:
        distribution = "Student's t with the effective degrees of freedom"
    else:
        distribution = "normal" if _is_normal(result) else _POSTERIOR
    return _uncertainty(result.printed_uncertainty, result.k, result.p, distribution)


def _is_normal(result: Result) -> bool:
    return abs(2.0 * float(ndtr(result.k)) - 1.0 - result.p) < _NORMAL_WITHIN


def _uncertainty(uncertainty: str, k: float, p: float, distribution: str) -> dict[str, str]:
    return {
        "uncertainty": uncertainty,
        "k": plain_number(k, _K_DIGITS),
        "p": plain_number(p, _K_DIGITS),
        "distribution": distribution,
    }


def _joint(certificate: Certificate) -> Mapping[str, Any]:
    """Return what the list of all results states of them together.

    Where a result's k is larger than that of a normal distribution, the ellipsoid's is larger by the same factor.
    """
    covariance = certificate.covariance
    by_symbol = {result.symbol: result for result in certificate.results}
    members = [by_symbol[name] for name in covariance.names]
    p = min(member.p for member in members)
    nu = min((member.nu_eff for member in members if member.nu_eff is not None), default=None)
    factor = ellipsoid_factor(len(covariance.units), p, nu)
    if nu is not None:
        distribution = f"multivariate t, {nu:.4g} degrees of freedom"
    elif all(map(_is_normal, members)):
        distribution = "normal"
    else:
        distribution = _POSTERIOR
        factor *= max(1.0, *(member.k / ellipsoid_factor(1, member.p, None) for member in members))
    return {
        "numbers": " ".join(number_text(member.value) for member in members),
        "units": [unit_of(unit) for unit in covariance.units],
        "k": plain_number(factor, _K_DIGITS),
        "p": plain_number(p, _K_DIGITS),
        "distribution": distribution,
    }


def ellipsoid_factor(n: int, p: float, nu: float | None) -> float:
    """Return the coverage factor of an ellipsoidal region (JCGM 102:2011, 6.5).

    With the multivariate t distribution (JCGM 102:2011, 5.3.2) the squared factor over n has an F distribution with n
    and nu degrees of freedom (Kotz and Nadarajah, Multivariate t Distributions and Their Applications, 2004); nu None
    is the normal distribution.

    >>> round(ellipsoid_factor(2, 0.95, None), 3), round(ellipsoid_factor(1, 0.95, 10.0), 3)
    (2.448, 2.228)
    """
    if nu is None:
        return math.sqrt(chdtri(n, 1.0 - p))
    return math.sqrt(n * fdtri(n, nu, p))


def _provenance(certificate: Certificate) -> dict[str, str]:
    """Return the sealed run that the certificate comes from, for programs."""
    run = certificate.run
    return {
        "id": run.id,
        "ledgerNumber": "" if run.ledger_number is None else str(run.ledger_number),
        "ledgerHead": run.ledger_head,
        "journalHead": run.journal_head,
        "sealSHA256": run.seal_sha256,
        "resultsSHA256": run.results_sha256,
        "sequenceSHA256": run.sequence_sha256,
        "stationSHA256": run.station_sha256,
        "signer": run.signer,
        "signerFingerprint": run.signer_fingerprint,
        "begun": certificate.begun_utc,
        "ended": certificate.ended_utc,
        "issued": certificate.issued_utc,
        "authorisingKey": certificate.authorised_by.key,
    }


def unit_of(unit: str) -> str:
    """Return the unit of a result in D-SI's notation. Raises ValueError when D-SI does not have it."""
    written = d_si_unit(unit)
    if written is None:
        raise ValueError(f"D-SI has no unit {unit!r}")
    return written


def joined(*parts: str) -> str:
    """Join texts that are not empty, with a semicolon where there is no full stop."""
    whole = ""
    for part in filter(None, map(str.strip, parts)):
        between = "" if not whole else (" " if whole.endswith(".") else "; ")
        whole += between + part
    return whole


def number_text(value: float) -> str:
    """Return a finite number as D-SI writes it, with all its digits.

    >>> number_text(-0.25), number_text(1e-7), number_text(3)
    ('-0.25', '1e-07', '3.0')
    """
    text = repr(float(value))
    if not text.strip("-")[0].isdigit():
        raise ValueError(f"{text} is not a number that D-SI can state")
    return text
