"""Hints in messages."""

import difflib

import pytest

from sequences.queue import Queue
from sequences.reader import DocumentFaults, check_document
from sequences.wording import MOST_COMPARED, MOST_LISTED, did_you_mean


def test_of_thousands_of_names_some_are_compared_and_listed(monkeypatch):
    compared, real = [], difflib.get_close_matches
    monkeypatch.setattr(
        difflib,
        "get_close_matches",
        lambda word, names, n: compared.append(len(names)) or real(word, names, n),
    )
    sentence = did_you_mean("?", [f"set {i}" for i in range(2000)])
    assert compared == [MOST_COMPARED]
    assert sentence.count("set ") == MOST_LISTED
    assert sentence.endswith(f" and {2000 - MOST_LISTED} more.")


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (
            'start_at: "7:30"',
            "start_at: must be a time of day from 00:00 to 23:59, such as 07:30 (got '7:30').",
        ),
        (
            "jobs: [{name: cam 7, sequence: a, station: b}]",
            "jobs[0].name: must be up to 40 letters from A to Z, digits, - and _, such as cam-7 (got 'cam 7').",
        ),
        ('name: " night"', "name: must be one line of text without blanks at its ends (got ' night')."),
    ],
)
def test_a_text_of_another_form_is_told_in_words_what_it_must_be(written, message):
    with pytest.raises(DocumentFaults) as refused:
        check_document(f"format: starbench/queue/1\n{written}\n".encode(), "q.yaml", Queue)
    assert any(str(fault).endswith(message) for fault in refused.value.faults)
