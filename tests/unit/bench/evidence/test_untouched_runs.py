"""What happens to any archive, and a signature of a person, leave a sealed run valid."""

import os
from pathlib import Path

import pytest

from bench.evidence.keys import AUTHORISATION_NAMESPACE, create_key
from bench.evidence.signers import Signer, read_signers
from bench.evidence.sshsig import sign
from tests.unit.bench.evidence.attack_steps import checked, copied
from tests.unit.bench.evidence.resealed import kinds

pytestmark = pytest.mark.usefixtures("made_once")


def unchanged(folder):
    return folder


def renamed(folder):
    return folder.rename(folder.with_name("another name, with ü"))


def older(folder):
    for path in folder.rglob("*"):
        os.utime(path, (0, 0))
    return folder


def read_only(folder):
    for path in [*folder.rglob("*"), folder]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    return folder


def other_modes(folder):
    for path in folder.rglob("*"):
        path.chmod(0o700 if path.is_dir() else 0o600)
    return folder


def linked(folder):
    link = folder.with_name("link")
    link.symlink_to(folder)
    return link


@pytest.mark.parametrize(
    "change", [unchanged, renamed, older, read_only, other_modes, linked], ids=lambda c: c.__name__
)
def test_what_happens_to_any_archive_leaves_it_valid(run_once, trusted, tmp_path, change):
    folder = change(copied(run_once, tmp_path / "run"))
    found = checked(folder, trusted)
    assert (found.faults, found.not_compared) == ((), ())


def test_a_relative_path_leaves_it_valid(run_once, trusted, monkeypatch):
    monkeypatch.chdir(run_once.parent)
    assert checked(Path("run"), trusted).complete


def test_an_authorised_run_is_valid_and_names_the_person(forger, trusted, tmp_path):
    person = create_key(tmp_path / "ada", principal="ada@lab.example")
    public = read_signers(tmp_path / "ada" / "allowed_signers")[0].public_key
    seal = (forger / "SHA256SUMS.sig").read_bytes()
    signature = sign(person.private, seal, AUTHORISATION_NAMESPACE)
    (forger / "SHA256SUMS.authorised.sig").write_bytes(signature)
    ada = Signer("ada@lab.example", public, (AUTHORISATION_NAMESPACE,))
    found = checked(forger.folder, [*trusted, ada])
    assert found.complete
    assert (found.state, found.person) == ("AUTHORISED", "ada@lab.example")
    assert kinds(checked(forger.folder, trusted)) == [("authorisation", "SHA256SUMS.authorised.sig")]
