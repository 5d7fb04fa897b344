"""The limits of a certificate: those of the laboratory and those of the run, of which it leaves none out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bench.base.errors import EvidenceError
from bench.extras.certificate.certificate_data import Conformity
from bench.extras.certificate.lab_config import LabConfig, LabRuleConfig
from bench.record.results import LimitStatement, Results
from bench.record.run_verdict import Limits
from bench.wording.conformity import conformity_headline, conformity_sentences

_PASSES = frozenset({"pass", "conditionalPass"})


def rules_of(results: Results, lab: LabConfig) -> list[LabRuleConfig]:
    """Return the laboratory's limits for conformity, then those of the run that it does not state itself."""
    own = list(lab.decision_rules or ())
    stated = {limits_of(statement) for statement in own}
    return own + [rule for rule in _rules_of_run(results) if limits_of(rule) not in stated]


def _rules_of_run(results: Results) -> Iterator[LabRuleConfig]:
    for statement in _statements(results):
        if statement.result in results["calibration"]["camera"]:
            by = f"limits of the run's {statement.stated_by}"
            text = f"{statement.specification} ({by})" if statement.specification else by
            # The run's own check of its text holds.
            yield LabRuleConfig.model_construct(
                result=statement.result,
                specification=text,
                lower=statement.lower,
                upper=statement.upper,
            )


def _statements(results: Results) -> list[LimitStatement]:
    judged = results.get("conformity")
    return list(judged.statements) if judged else []


def limits_of(stated: LabRuleConfig | LimitStatement) -> Limits:
    """Return a result with its limits, as the laboratory or the run states them."""
    return stated.result, stated.lower, stated.upper


def limits_of_others(results: Results) -> list[str]:
    """Return a sentence for each limit of the run that is not kept, and whose result is none of the certificate."""
    judged = results.get("conformity")
    if judged is None:
        return []
    camera = results["calibration"]["camera"]
    others = [
        statement
        for statement in _statements(results)
        if statement.result not in camera and statement.verdict != "pass"
    ]
    return conformity_sentences(replace(judged, statements=others, reasons=[], rule=""))[: len(others)]


def despite_fail(results: Results) -> str:
    """Return the statement of a certificate with limits of the laboratory over a run that says FAIL."""
    judged = results.get("conformity")
    headline = conformity_headline(judged) if judged else ""
    return f"The sealed run says {headline} The laboratory states limits of its own beside them, for this reason:"


def passes_over_fail(results: Results, lab: LabConfig, conformity: tuple[Conformity, ...]) -> list[str]:
    """Return the results that pass by other limits than the run's although the run says FAIL; usually none."""
    judged = results.get("conformity")
    if judged is None or judged.passed:
        return []
    of_run = {limits_of(rule) for rule in _rules_of_run(results)}
    own = zip(lab.decision_rules or (), conformity, strict=False)  # those of the run follow
    return [
        statement.symbol
        for rule, statement in own
        if statement.verdict in _PASSES and limits_of(rule) not in of_run
    ]


def needed_reason(results: Results, lab: LabConfig, conformity: tuple[Conformity, ...], reason: str) -> str:
    """Return the reason for a pass over a FAIL, empty where there is none; `EvidenceError` where it is missing."""
    passes = passes_over_fail(results, lab, conformity)
    if not passes:
        return ""
    if not reason:
        failed = [statement for statement in _statements(results) if statement.verdict != "pass"]
        judged = results["conformity"]
        what = conformity_sentences(replace(judged, statements=failed))[: len(failed) + len(judged.reasons)]
        raise EvidenceError(
            f"The sealed run says FAIL: {' '.join(what)} By the limits of lab.yaml {', '.join(passes)} would pass.",
            where="decision_rules of lab.yaml",
            remedy="Leave these limits out of lab.yaml; the certificate then states those of the run. If both are"
            " wanted, say why: --despite-fail TEXT. It is printed.",
        )
    return reason
