"""The faults of a document, each with its place."""

from sequences.errors import DocumentFaults
from sequences.tree import Fault, Tree

FIRST = Fault("a.yaml", 4, 13, "run.light_hz", "not a number (got 'sixty').")
SECOND = Fault("a.yaml", 9, 2, "", "a second document.")


def test_several_faults_are_one_line_each_in_the_order_of_their_places():
    tree = Tree("a.yaml")
    error = DocumentFaults([SECOND, FIRST, SECOND], tree)
    assert error.faults == [FIRST, SECOND]
    assert error.tree is tree
    assert str(error) == error.what == f"{FIRST}\n{SECOND}"
    assert (error.where, error.remedy) == ("", "")
