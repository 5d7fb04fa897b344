import dcc_mutations
import pytest
from dcc_checks import check_dcc
from dcc_mutations import MUTATIONS
from lxml import etree

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


@pytest.mark.parametrize(
    ("lower", "verdicts"),
    [
        ("3343.9", {"pass"}),  # fx = 3346.4, guard band 2.5
        ("3344.0", {"conditionalPass"}),
        ("3346.5", {"conditionalFail"}),
        ("3348.9", {"fail", "conditionalFail"}),  # outside by just the guard band: rules differ
        ("3349.5", {"fail"}),
    ],
)
def test_verdicts_at_the_limits(lower, verdicts):
    data = dcc_mutations.full_dcc()
    root = etree.fromstring(data)
    path = f"{dcc_mutations.CONFORMITY}//si:value"
    limit, _, guard = dcc_mutations.find(root, path)
    limit.text, guard.text = lower, "2.5"
    verdict = dcc_mutations.find(root, f"{dcc_mutations.CONFORMITY}/dcc:conformity")[0]
    for name in ("pass", "conditionalPass", "conditionalFail", "fail"):
        verdict.text = name
        found = [fault for fault in check_dcc(etree.tostring(root)) if "the verdict on fx" in fault]
        assert bool(found) == (name not in verdicts), name
