"""The errors of the script language: one shape, and every fault of a document with its place."""

from sequences.errors import DocumentFaults, SequencesError
from sequences.tree import Fault, Tree

FIRST = Fault("a.yaml", 4, 13, "run.light_hz", "not a number (got 'sixty').")
SECOND = Fault("a.yaml", 9, 2, "", "a second document.")


def test_an_error_says_what_where_and_what_to_do():
    error = SequencesError("This is wrong.", where="a.yaml", remedy="Write it again.")
    assert (error.what, error.where, error.remedy) == ("This is wrong.", "a.yaml", "Write it again.")
    assert str(error) == "a.yaml: This is wrong. Write it again."


def test_several_faults_are_one_line_each_in_the_order_of_their_places():
    tree = Tree("a.yaml")
    error = DocumentFaults([SECOND, FIRST, SECOND], tree)
    assert error.faults == [FIRST, SECOND]
    assert error.tree is tree
    assert str(error) == error.what == f"{FIRST}\n{SECOND}"
    assert (error.where, error.remedy) == ("", "")
