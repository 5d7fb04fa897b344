"""A certificate as JSON: it comes back the same, and nothing else is taken."""

import dataclasses
import json

import pytest
from certificate_sample import full_certificate, small_certificate

from bench.base.errors import EvidenceError
from bench.certificate.certificate_data import Certificate


@pytest.mark.parametrize("make", [full_certificate, small_certificate])
def test_comes_back_the_same(make):
    certificate = make()
    data = certificate.to_json()
    assert Certificate.from_json(data) == certificate
    assert Certificate.from_json(data).to_json() == data


def changed(change):
    found = json.loads(full_certificate().to_json())
    change(found)
    return json.dumps(found).encode()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda c: c.pop("number"), "number is missing"),
        (lambda c: c.update(numbr="x"), "numbr is unknown"),
        (lambda c: c["results"][2].update(U="2.9"), r"results\[2\].U must be a finite number"),
        (lambda c: c["results"][0].update(value=True), r"results\[0\].value must be a finite number"),
        (lambda c: c["conformity"][0].update(verdict="passed"), "one of pass, conditionalPass"),
        (lambda c: c.update(simulated=1), "simulated must be true or false"),
        (lambda c: c.update(results={}), "results must be a list"),
        (lambda c: c.update(laboratory=None), "laboratory must be a mapping"),
        (lambda c: c.update(format="starbench/certificate/2"), "format must be one of"),
        (lambda c: c["covariance"].update(matrix=[[None]]), r"covariance.matrix\[0\]\[0\]"),
    ],
)
def test_refuses_what_is_not_of_this_form_and_names_it(change, named):
    with pytest.raises(EvidenceError, match=named):
        Certificate.from_json(changed(change))


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b'{"a":1,"a":2}', b"\xff", b"[" * 100_000, b"null"])
def test_refuses_what_is_no_json_mapping(text):
    with pytest.raises(EvidenceError):
        Certificate.from_json(text)


def test_refuses_numbers_that_are_not_finite():
    with pytest.raises(EvidenceError, match="NaN"):
        Certificate.from_json(changed(lambda c: c["results"][0].update(value=float("nan"))))
    one = full_certificate()
    broken = dataclasses.replace(one.results[0], value=float("inf"))
    with pytest.raises(ValueError, match="Out of range"):
        dataclasses.replace(one, results=(broken,)).to_json()
