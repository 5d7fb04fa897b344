"""The sections of the certificate that hold numbers: results, conformity, projection, covariance, changes.

Turns the certificate into blocks; touches no files and computes nothing but correlations.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence

from bench.certificate.certificate_data import Budget, BudgetRow, Certificate, Conformity, Covariance, Result
from bench.certificate.pdf_blocks import (
    NU,
    SUPERSCRIPTS,
    Align,
    Block,
    Cell,
    at_the_point,
    bullets,
    compact,
    freedom,
    heading,
    mono,
    pairs,
    paragraph,
    percent,
    printed,
    stated,
    table,
    together,
    with_index,
    with_note,
    with_unit,
)
from bench.report.text import NOTHING

_ONE_PAGE = 30
"""A budget with no more rows stays on one page."""


def budgets(certificate: Certificate) -> list[Block]:
    """Return one table for each result, and the list of the sources that they refer to."""
    sources = _sources(certificate.budgets)
    blocks: list[Block] = []
    common = _common(certificate.budgets)
    for one in certificate.budgets:
        title = f"{one.symbol}, in {one.unit}" if one.unit != "1" else f"{one.symbol}, a pure number"
        own = " ".join(text for text in one.remarks if text not in common)
        parts = [heading(title), _budget(one, sources, own)]
        blocks += [together(*parts)] if len(one.rows) <= _ONE_PAGE else parts
    legend = (
        "uᵢ is the contribution to the standard uncertainty of the result, in the unit of the result. Share is its part"
        " of the variance. A dash stands where the joint adjustment itself gives the contribution. [S1] and so on refer"
        " to the list of sources after the last budget."
    )
    return [
        paragraph(legend, "note", sticky=True),
        *blocks,
        *([bullets(common)] if common else []),
        *_source_list(sources),
    ]


def _common(found: Sequence[Budget]) -> list[str]:
    """Return the remarks of more than one budget, each once; the others stand below their own budget."""
    said = Counter(text for one in found for text in set(one.remarks))
    texts = dict.fromkeys(text for one in found for text in one.remarks)
    return [text for text in texts if said[text] > 1]


def _sources(found: Sequence[Budget]) -> dict[tuple[str, str, str, str], str]:
    """Number the sources of all budgets in the order of their first use."""
    keys = dict.fromkeys(_key(row) for one in found for row in one.rows)
    return {key: f"S{number}" for number, key in enumerate(keys, 1)}


def _key(row: BudgetRow) -> tuple[str, str, str, str]:
    return row.source, row.number, row.date, row.sha256


def _budget(one: Budget, sources: dict[tuple[str, str, str, str], str], remark: str) -> Block:
    rows: list[list[Cell]] = [
        [
            f"{row.name} [{sources[_key(row)]}]",
            row.type,
            with_unit(stated(row.value, 5), row.unit),
            row.distribution,
            compact(row.divisor, 4),
            with_unit(compact(row.sensitivity), row.sensitivity_unit),
            compact(row.u),
            percent(row.share),
            freedom(row.nu),
        ]
        for row in one.rows
    ]
    total = (
        f"Combined standard uncertainty {with_unit(compact(one.u, 4), one.unit)};"
        f" effective degrees of freedom {freedom(one.nu_eff)};"
        f" k = {compact(one.k, 4)}; U = {with_unit(compact(one.U, 2), one.unit)}"
    )
    return table(
        [
            "Source of uncertainty", "Type", "Value", "Distribution", "Divisor", "Sensitivity",
            with_index("u", "i"), "Share, %", NU,
        ],
        rows,
        [2.25, "auto", 1.3, "auto", "auto", 1.2, "auto", "auto", "auto"],
        ["left", "left", "right", "left", "right", "right", "right", "right", "right"],
        size=6.6, pad=0.75, gap=0.8, foot=with_note(total, remark, bold=True),
    )  # fmt: skip


def _source_list(sources: dict[tuple[str, str, str, str], str]) -> list[Block]:
    if not sources:
        return []
    rows: list[list[Cell]] = []
    for (source, number, date, sha256), label in sources.items():
        certificate = ", ".join(filter(None, (number, date)))
        rows.append([label, source or NOTHING, certificate or NOTHING, mono(sha256) or NOTHING])
    head: list[Cell] = ["", "Source", "Certificate", "SHA-256 of the certificate's file"]
    return [heading("Sources of the budgets"), table(head, rows, ["auto", 1.1, 0.9, 1.2], size=7.0, pad=0.9)]


_MARK = "†"
_RIGHT: Align = "right"
_MOST_COLUMNS = 8
_FEW = 3
"""Statements of conformity, if no more, stay on one page with their rule and their words."""
_VERDICTS = {
    "pass": "the value is inside the limits by the guard band or more",
    "conditionalPass": "the value is inside the limits, but by less than the guard band",
    "conditionalFail": "the value is outside the limits, but by the guard band at most",
    "fail": "the value is outside the limits by more than the guard band",
}
_POWER = re.compile(r"\^(\d+)")


def results(certificate: Certificate) -> list[Block]:
    """Return the table of the results."""
    found = certificate.results
    values = at_the_point([printed(one.printed_value) for one in found])
    expanded = at_the_point([printed(one.printed_uncertainty) for one in found])
    rows = [
        [
            {"text": one.symbol + (f" {_MARK}" if one.customer_supplied else ""), "bold": True},
            one.name,
            value,
            uncertainty,
            one.unit,
            compact(one.k),
            f"{100 * one.p:.2f} %",
            freedom(one.nu_eff),
        ]
        for one, value, uncertainty in zip(found, values, expanded, strict=True)
    ]
    shown = table(
        ["Symbol", "Quantity", "Value", "U", "Unit", "k", "p", with_index(NU, "eff")],
        rows,
        ["auto", 1, "auto", "auto", "auto", "auto", "auto", "auto"],
        ["left", "left", "right", "right", "left", "right", "right", "right"],
        size=8.6,
        pad=1.5,
        gap=2.2,
    )
    blocks = [shown, paragraph(certificate.statement("uncertainty"), "note")]
    if model := certificate.statement("model"):
        blocks.append(paragraph(_POWER.sub(lambda found: found[1].translate(SUPERSCRIPTS), model)))
    if any(one.customer_supplied for one in found):
        blocks.append(
            paragraph(
                f"{_MARK} This value depends on data that the customer supplied. They can affect its validity.",
                "note",
            )
        )
    return blocks


def conformity(certificate: Certificate) -> list[Block]:
    """Return the statements of conformity, each with its limits and its rule."""
    found = certificate.conformity
    if not found:
        return [paragraph("No statement of conformity was asked for.")]
    values = {one.symbol: one for one in certificate.results}
    rules = {one.rule for one in found}
    rows: list[list[Cell]] = []
    for one in found:
        result = values.get(one.symbol)
        rows.append(
            [
                {"text": one.symbol, "bold": True},
                one.specification if len(rules) == 1 else with_note(one.specification, one.rule),
                _limits(one),
                _with_uncertainty(result) if result else NOTHING,
                with_unit(stated(one.guard_band), one.unit),
                {"text": one.verdict, "verdict": one.verdict},
            ]
        )
    unexplained = {one.verdict for one in found if f"{one.verdict}:" not in one.rule}
    said = f"Specification{'' if len(rules) == 1 else ' and decision rule'}"
    shown = table(
        ["Result", said, "Limits", "Value \N{PLUS-MINUS SIGN} U", "Guard band w", "Statement"],
        rows,
        ["auto", 1, "auto", "auto", "auto", "auto"],
        size=8.2,
        pad=1.4,
    )
    words = [f"{word}: {meaning}" for word, meaning in _VERDICTS.items() if word in unexplained]
    legend = [paragraph("; ".join(words) + ".", "note")] if words else []
    blocks = [*([_rule(found[0].rule)] if len(rules) == 1 else []), shown, *legend]
    return [together(*blocks)] if len(rows) <= _FEW else blocks


def _rule(text: str) -> Block:
    named = text if text.casefold().startswith("decision rule") else f"Decision rule: {text}"
    return paragraph(named, sticky=True)


def _with_uncertainty(one: Result) -> str:
    value = f"{printed(one.printed_value)} \N{PLUS-MINUS SIGN} {printed(one.printed_uncertainty)}"
    return with_unit(value, one.unit)


def _limits(one: Conformity) -> str:
    lower, upper = stated(one.lower), stated(one.upper)
    if one.lower is None:
        return with_unit(f"at most {upper}", one.unit)
    if one.upper is None:
        return with_unit(f"at least {lower}", one.unit)
    return with_unit(f"{lower} to {upper}", one.unit)


def projection(certificate: Certificate) -> list[Block]:
    """Return the numbers about the calibration as a whole.

    Returns: The blocks; none if the certificate has no such numbers.
    """
    if not certificate.further:
        return []
    rows = [[one.name[:1].upper() + one.name[1:], printed(one.text)] for one in certificate.further]
    shown = table(["Quantity", "Value"], rows, [1, "auto"], ["left", "right"], size=8.2)
    return [together(shown)]


def covariance(certificate: Certificate) -> list[Block]:
    """Return covariance and correlation of the results; a large matrix in several parts."""
    found = certificate.covariance
    units = ", ".join(
        f"{name} in {unit}" for name, unit in zip(found.names, found.units, strict=True) if unit != "1"
    )
    text = "The element of row i and column j has the unit of i times that of j"
    text += f" ({units}; the others are pure numbers)." if units else "."
    text += " Both matrices are symmetric; the lower half is printed, with six significant digits."
    text += " All digits are in the attached files."
    return [
        paragraph(text, "note", sticky=True),
        *_matrix("Covariance", found, [[f"{value:.5e}" for value in row] for row in found.matrix]),
        *_matrix("Correlation", found, _correlations(found)),
    ]


def _correlations(found: Covariance) -> list[list[str]]:
    sigma = [math.sqrt(max(row[at], 0.0)) for at, row in enumerate(found.matrix)]
    return [
        [
            printed(f"{value / (sigma[i] * sigma[j]) + 0.0:.4f}") if sigma[i] and sigma[j] else NOTHING
            for j, value in enumerate(row)
        ]
        for i, row in enumerate(found.matrix)
    ]


def _matrix(title: str, found: Covariance, texts: list[list[str]]) -> list[Block]:
    """Return the lower half of a matrix, at most eight columns in a table."""
    blocks: list[Block] = []
    count = len(found.names)
    for first in range(0, count, _MOST_COLUMNS):
        columns = range(first, min(first + _MOST_COLUMNS, count))
        rows: list[list[Cell]] = [
            [
                {"text": found.names[i], "bold": True},
                *(_exponent(texts[i][j]) if j <= i else "" for j in columns),
            ]
            for i in range(first, count)
        ]
        part = (
            f", columns {found.names[columns[0]]} to {found.names[columns[-1]]}"
            if count > _MOST_COLUMNS
            else ""
        )
        shown = table(
            ["", *(found.names[j] for j in columns)],
            rows,
            ["auto", *([1] * len(columns))],
            ["left", *(_RIGHT for _ in columns)],
            size=6.8 if len(columns) > 6 else 7.4,
            gap=0.6,
            pad=0.9,
        )
        blocks.append(together(heading(title + part), shown))
    return blocks


def _exponent(text: str) -> str:
    """Shorten the exponent of a number, so that it can still be copied into a program."""
    mantissa, e, power = text.partition("e")
    return f"{mantissa}e{int(power)}" if e else text


def before_adjustment(certificate: Certificate) -> list[Block]:
    """Return the earlier calibration beside the results, and the change since then.

    Returns: The blocks; none if no earlier calibration is known.
    """
    before = certificate.before_adjustment
    if before is None:
        return []
    now = {one.symbol: one for one in certificate.results}
    blocks = [
        paragraph(before.text, sticky=True),
        pairs(
            [("Number", before.number), ("Date", before.date), ("SHA-256 of its seal", mono(before.sha256))]
        ),
    ]
    rows: list[list[Cell]] = []
    for one in before.values:
        result = now.get(one.symbol)
        rows.append(
            [
                {"text": one.symbol, "bold": True},
                stated(one.value),
                stated(one.U),
                printed(result.printed_value) if result else NOTHING,
                printed(result.printed_uncertainty) if result else NOTHING,
                one.unit,
            ]
        )
    if rows:
        blocks.append(
            table(
                ["Symbol", "Value before", "U before", "Value now", "U now", "Unit"],
                rows,
                ["auto", 1, 1, 1, 1, "auto"],
                ["left", "right", "right", "right", "right", "left"],
            )
        )
    changes = [
        ("RMS change of an image point since then", _pixels(before.change_rms_px)),
        ("Largest change of an image point", _pixels(before.change_largest_px)),
    ]
    return [*blocks, pairs(changes, label_mm=70)]


def _pixels(value: float | None) -> str:
    return "" if value is None else f"{compact(value)} px"
