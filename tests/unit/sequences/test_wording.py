"""Hints in messages."""

import difflib

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
