"""Every fault in every state where it can happen ends as it must, in time, with its evidence; and the document says so."""

import re
from pathlib import Path

import pytest
from fault_matrix import SIGNS, STATES, matrix, patched, strike, text
from run_faults import FAULTS

DOCUMENT = Path(__file__).parents[4] / "docs" / "faults.md"
SOME = [
    ("stage unplugged", "slewing"),
    ("camera lost for 20 s, interlock `device_lost`", "recording"),
    ("recording interrupted", "recording"),
    ("events or triggers lost", "recording"),
    ("disk full", "checking"),
    ("process killed", "parking"),
    ("SIGINT, SIGTERM, SIGHUP", "homing"),
    ("abort by an operator", "holding"),
]


def signs(document):
    """The table without its times: fault, state, sign."""
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in document[document.index("| fault |") :].splitlines()
        if line.startswith("|")
    ]
    states = rows[0][1:]
    return {
        (row[0], state): cell.split()[0]
        for row in rows[2:]
        for state, cell in zip(states, row[1:], strict=True)
    }


def test_the_document_has_every_fault_and_every_state():
    told = signs(DOCUMENT.read_text())
    assert set(told) == {(fault.name, state) for fault in FAULTS for state in STATES}
    for fault in FAULTS:
        assert any(told[fault.name, state] != "-" for state in STATES), fault.name


@pytest.mark.parametrize(("name", "state"), SOME)
def test_a_fault_ends_as_documented(tmp_path, name, state):
    (fault,) = [fault for fault in FAULTS if fault.name == name]
    with patched() as patch:
        cell = strike(fault, state, tmp_path, patch)
    assert cell.wrong == ()
    assert SIGNS[cell.end] == signs(DOCUMENT.read_text())[name, state]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_fault_in_every_state_ends_as_documented(tmp_path):
    cells = list(matrix(tmp_path))
    wrong = [f"{fault.name} in {state}: {cell.wrong}" for fault, state, cell in cells if cell.wrong]
    assert wrong == []
    assert signs(text(cells, 0)) == signs(DOCUMENT.read_text())
    assert sum(cell.end != "" for _, _, cell in cells) > 100
    named = [cell.why for _, _, cell in cells if cell.end == "failed"]
    assert all(re.search(r"[a-z]{4}", why) for why in named)
