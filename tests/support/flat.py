"""Sequences of a few lines, and their steps."""

from sequences.errors import DocumentFaults
from sequences.flatten import unfold
from sequences.reader import check_document
from sequences.schema import Sequence

HEAD = "format: starbench/sequence/1\nname: test\n"


def read(text):
    """Check a sequence that has a head of two lines before this text."""
    return check_document((HEAD + text).encode(), "s.yaml", Sequence)


def flatten(document):
    """Return the steps of a sequence without faults."""
    steps, faults = unfold(document)
    if faults:
        raise DocumentFaults(faults)
    return steps


def steps_of(text):
    return flatten(read(text))


def faults_of(text):
    """Return all faults of a sequence, as text; none if it has none."""
    try:
        steps_of(text)
    except DocumentFaults as error:
        return [str(fault) for fault in error.faults]
    return []
