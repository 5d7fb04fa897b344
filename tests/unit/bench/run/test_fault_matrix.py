"""Every fault in every state where it can happen ends as it must, in time, with its evidence; and the document says so."""

import re

import pytest
from fault_matrix import DOCUMENT, ENDS, STATES, matrix, patched, strike, text
from run_faults import FAULTS

SOME = [
    ("stage unplugged", "slewing"),
    ("stage lost for 20 s, interlock `device_lost`", "homing"),
    ("light lost for 20 s, interlock `device_lost`", "recording"),
    ("light silently off", "recording"),
    ("camera lost for 20 s, interlock `device_lost`", "recording"),
    ("camera unplugged", "parking"),
    ("recording interrupted", "recording"),
    ("stage creeps during a recording", "recording"),
    ("events or triggers lost", "recording"),
    ("disk full", "checking"),
    ("process killed", "parking"),
    ("SIGINT, SIGTERM, SIGHUP", "homing"),
    ("abort by an operator", "holding"),
]


def ends_in(document):
    """The table of the document: fault, state, and how the run ended; empty if the fault cannot occur there."""
    ends = {shown: end for end, shown in ENDS.items()}
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in document[document.index("| fault |") :].splitlines()
        if line.startswith("|")
    ]
    end_of = {(row[0], state): "" for row in rows[2:] for state in STATES}
    for name, *cells in rows[2:]:
        for shown, cell in zip(rows[0][1:], cells, strict=True):
            for state in STATES if cell == "every state" else filter(None, cell.split(", ")):
                assert end_of[name, state] == "", (name, state)
                end_of[name, state] = ends[shown]
    return end_of


def test_the_document_has_every_fault_and_every_state():
    end_of = ends_in(DOCUMENT.read_text())
    assert set(end_of) == {(fault.name, state) for fault in FAULTS for state in STATES}
    for fault in FAULTS:
        assert any(end_of[fault.name, state] for state in STATES), fault.name


@pytest.mark.parametrize(("name", "state"), SOME)
def test_a_fault_ends_as_documented(tmp_path, name, state):
    (fault,) = [fault for fault in FAULTS if fault.name == name]
    with patched() as patch:
        cell = strike(fault, state, tmp_path, patch)
    assert cell.wrong == ()
    assert cell.end == ends_in(DOCUMENT.read_text())[name, state]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_fault_in_every_state_ends_as_documented(tmp_path):
    cells = list(matrix(tmp_path))
    wrong = [f"{fault.name} in {state}: {cell.wrong}" for fault, state, cell in cells if cell.wrong]
    assert wrong == []
    assert text(cells) == DOCUMENT.read_text()
    assert sum(cell.end != "" for _, _, cell in cells) > 100
    named = [cell.why for _, _, cell in cells if cell.end == "failed"]
    assert all(re.search(r"[a-z]{4}", why) for why in named)
