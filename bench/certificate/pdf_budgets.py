"""The section of the certificate with the uncertainty budgets. Turns them into blocks; computes nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from bench.certificate.certificate_data import Budget, BudgetRow, Certificate
from bench.certificate.pdf_blocks import (
    NU,
    Block,
    Cell,
    bullets,
    compact,
    freedom,
    heading,
    mono,
    paragraph,
    percent,
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
    """Return one table for each result, and the list of the sources that they refer to.

    Returns: The blocks.
    """
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
