import dcc_mutations
import pytest
from dcc_mutations import MUTATIONS

from bench.certificate.dcc_checks import check_dcc

OURS = [one for one in MUTATIONS if one.ours]


@pytest.mark.parametrize("dcc", [dcc_mutations.full_dcc, dcc_mutations.small_dcc])
def test_an_untouched_certificate_has_no_fault(dcc):
    assert check_dcc(dcc()) == []


def test_there_are_many_mutations():
    assert len(OURS) >= 60
    assert len({one.name for one in MUTATIONS}) == len(MUTATIONS)


@pytest.mark.parametrize("mutation", OURS, ids=lambda one: one.name)
def test_a_mutation_is_found(mutation):
    found = check_dcc(mutation.apply())
    assert any(mutation.ours in fault for fault in found), found


def test_the_list_of_faults_ends():
    found = check_dcc(dcc_mutations.full_dcc().replace(b"<si:unit>", b"<si:unit>x"))
    assert len(found) == 201
    assert found[-1] == "and more"
