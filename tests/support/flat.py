"""The steps of a sequence, for tests of sequences without faults."""

from sequences.errors import DocumentFaults
from sequences.flatten import unfold


def flatten(document):
    steps, faults = unfold(document)
    if faults:
        raise DocumentFaults(faults)
    return steps
