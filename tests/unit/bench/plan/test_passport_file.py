"""Passport files: sealed ones that were changed, and numbers that no collimator has, are refused with a reason."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.base.errors import EvidenceError, UsageError
from bench.evidence.seal import read_passport_seal, seal_passport
from bench.plan.passports import parse_passport, passport_bytes, read_passport_file
from bench.results.passports import seal_file, seals_of, write_passport
from calib.model.passport import Passport

NAMES = ("x", "y", "r")
SIGMA = np.array([0.03, 0.04, 0.05])


def passport(covariance=None, values=(97.0, 141.0, 255.0)):
    covariance = np.diag(SIGMA**2) if covariance is None else covariance
    return Passport(NAMES, np.array(values), covariance, conditions={"collimator": "C-1"})


def altered(**fields):
    return json.dumps(passport().to_dict() | fields).encode()


def test_a_sealed_passport_is_the_unsealed_one_with_one_line_more(key):
    data = passport_bytes(passport())
    sealed = seal_passport(data, key)
    lines = sealed.splitlines(keepends=True)
    assert b"".join([lines[0], *lines[2:]]) == data
    assert read_passport_seal(data) is None
    assert read_passport_seal(sealed).fingerprint == key.fingerprint
    assert parse_passport(sealed, "p").values_by_name == passport().values_by_name
    with pytest.raises(EvidenceError):
        seal_passport(sealed, key)


def test_stock_tools_check_the_seal_as_the_documentation_says(tmp_path, key, home):
    if shutil.which("ssh-keygen") is None:
        pytest.skip("ssh-keygen is not installed")
    sealed = seal_passport(passport_bytes(passport()), key)

    def accepted(data):
        (tmp_path / "collimator.json").write_bytes(data)
        script = r"""
            sed -n 's/^ "seal": "\\(.*\\)",$/\\1/p' collimator.json | sed 's/\\\\n/\\n/g' > seal.sig
            grep -v '^ "seal": ' collimator.json |
                ssh-keygen -Y verify -f "$0" -I bench1@lab.example -n starbench-report@v1 -s seal.sig
        """.replace("\\\\", "\\")
        words = ["bash", "-c", script, str(home / "allowed_signers")]
        return subprocess.run(words, cwd=tmp_path, capture_output=True, check=False).returncode == 0

    assert accepted(sealed)
    assert not accepted(sealed.replace(b"255.0", b"255.1"))


@given(st.data())
def test_no_byte_of_a_sealed_passport_can_be_changed(key, data):
    sealed = bytearray(seal_passport(passport_bytes(passport()), key))
    place = data.draw(st.integers(0, len(sealed) - 1))
    sealed[place] ^= data.draw(st.integers(1, 255))
    try:
        found = read_passport_seal(bytes(sealed))
    except EvidenceError:
        return
    if found is not None:  # the changed byte is not within what base64 counts
        raise AssertionError(bytes(sealed[place - 20 : place + 20]))
    with pytest.raises(UsageError):
        parse_passport(bytes(sealed), "p")


@pytest.mark.parametrize("indent", [None, 1, 2])
def test_a_sealed_passport_written_anew_by_another_program_is_refused(key, indent):
    sealed = seal_passport(passport_bytes(passport()), key)
    document = json.loads(sealed)
    document["covariance"][2][2] /= 1e4
    with pytest.raises(UsageError, match=r"was changed after it was sealed|not on its second line"):
        parse_passport((json.dumps(document, indent=indent) + "\n").encode(), "p")
    moved = {name: document[name] for name in sorted(document)}
    with pytest.raises(UsageError, match="not on its second line"):
        parse_passport((json.dumps(moved, indent=1) + "\n").encode(), "p")


@pytest.mark.parametrize(
    ("covariance", "says"),
    [
        (np.zeros((3, 3)), "variance of x in its covariance is 0"),
        (np.diag(SIGMA**2) * 1e-300, "no measurement is that certain"),
        (np.diag([1e-3, 1e-3, 1e-300]), "variance of r"),
        (np.diag([1e-3, 1e-3, (255e-9) ** 2]), "variance of r"),
        (np.diag([1e-3, 1e-3, -1e-3]), "positive semidefinite|variance"),
        (np.diag([1e-3, 1e-3, 1e300]), "too large"),
        (np.full((3, 3), 1e-3), "positive definite"),
        (np.array([[1e-12, 0, 5e-13], [0, 1e-3, 0], [0, 0, 1e-12]]), "variance|symmetric"),
        (np.array([[1e-9, 0, 5e-10], [0, 1e-9, 0], [0, 0, 1e-9]]), "not symmetric"),
        (np.array([[1e-3, 2e-3, 0], [2e-3, 1e-3, 0], [0, 0, 1e-3]]), "positive"),
    ],
)
def test_a_covariance_that_no_measurement_gives_is_refused(covariance, says):
    with pytest.raises(UsageError, match=says):
        parse_passport(altered(covariance=covariance.tolist()), "p")


@pytest.mark.parametrize(
    "values", [[97, 141, 1e-300], [97, 141, 0], [97, 141, -255], [97, 141, 1e300], [97, 141, 10**400]]
)
def test_values_that_no_collimator_has_are_refused(values):
    with pytest.raises(UsageError):
        parse_passport(altered(values=values), "p")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"values"', '"covariance": [], "values"', "'covariance' is there twice"),
        ('"collimator": "C-1"', '"collimator": "C-1", "collimator": "C-2"', "'collimator' is there twice"),
        ("255.0", "NaN", "NaN is not a number"),
        ("255.0", "Infinity", "Infinity is not a number"),
        ("255.0", "1e999", "too large|finite"),
    ],
)
def test_json_that_readers_take_differently_is_refused(old, new, says):
    with pytest.raises(UsageError, match=says):
        parse_passport(altered().replace(old.encode(), new.encode(), 1), "p")


def test_the_covariance_of_a_usual_passport_is_accepted():
    drawn = np.random.default_rng(1)
    for _ in range(50):
        some = drawn.normal(size=(3, 3)) * SIGMA[:, None]
        assert parse_passport(passport_bytes(passport(some @ some.T + 1e-6 * np.diag(SIGMA**2))), "p")
    close = np.outer(SIGMA, SIGMA) * np.array([[1, 0.9999, 0], [0.9999, 1, 0], [0, 0, 1]])
    assert parse_passport(passport_bytes(passport(close)), "p")


def test_a_passport_without_a_seal_gets_one_in_a_new_file(tmp_path, key):
    (tmp_path / "hand.json").write_bytes(altered())
    seal_file(tmp_path / "hand.json", tmp_path / "sealed.json", key)
    data = (tmp_path / "sealed.json").read_bytes()
    assert read_passport_seal(data).fingerprint == key.fingerprint
    assert read_passport_file(tmp_path / "sealed.json")[0].to_dict() == passport().to_dict()
    with pytest.raises(UsageError, match="sealed already"):
        seal_file(tmp_path / "sealed.json", tmp_path / "again.json", key)
    write_passport(tmp_path / "plain.json", passport())
    assert read_passport_seal((tmp_path / "plain.json").read_bytes()) is None


def test_a_passport_names_the_seals_of_its_runs(sealed_once, tmp_path):
    import hashlib

    found = seals_of([sealed_once, tmp_path, tmp_path / "points.csv"])
    assert found == {"sealed": hashlib.sha256((sealed_once / "SHA256SUMS").read_bytes()).hexdigest()}
