"""A person's authorisation beside a seal: who may give it, what stock programs say, and that nothing else changes."""

import json
import os
import re
import shutil
import stat
from datetime import UTC, datetime, timedelta

import pytest
from authorising import make_key, needs_certificates, needs_ssh_keygen, person
from refusals import full
from unchecked_seal import seal_unchecked

from bench.base.errors import EvidenceError, StorageError
from bench.evidence import beside_seal
from bench.evidence.authorisation import authorise
from bench.evidence.beside_seal import add_beside
from bench.evidence.key_trust import Trust
from bench.evidence.keys import create_key
from bench.evidence.seal import RESERVED, seal
from bench.evidence.signers import AUTHORISATION_NAMESPACE, NAMESPACE, Signer
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.states import State, shown_state, standing_of, stated_time
from bench.evidence.verify import verify_folder
from tests.unit.bench.evidence.resealed import copied

NOW = datetime(2026, 5, 1, tzinfo=UTC)

pytestmark = needs_ssh_keygen


@pytest.fixture
def trust(signers, ada):
    return Trust((*signers, ada[1]))


@pytest.fixture
def certificate(tmp_path, key, ada):
    """A sealed folder with a certificate that names Ada."""
    folder = tmp_path / "certificate"
    folder.mkdir()
    named = {"name": "Ada Example", "role": "head", "key_fingerprint": fingerprint(ada[0].public_key)}
    (folder / "certificate.json").write_text(
        json.dumps({"number": "7", "issued_utc": "2026-03-02T00:00:00Z", "authorised_by": named})
    )
    seal_unchecked(folder, key)
    return folder


def faults(folder, trust, **more):
    return [(f.kind, f.where, f.what) for f in standing_of(folder, trust, NOW, **more).faults]


def modes(folder):
    return {path: stat.S_IMODE(path.stat().st_mode) for path in [folder, *folder.rglob("*")]}


def test_draft_sealed_authorised(make_run, key, tmp_path, ada, trust):
    with make_run(tmp_path / "run") as folder:
        run = folder.path
        assert standing_of(run, trust, NOW).state is State.DRAFT
        assert shown_state(run, trust, NOW).text == "DRAFT: not sealed"
        seal(folder, key)
    assert standing_of(run, trust, NOW).state is State.SEALED
    assert shown_state(run, trust, NOW).text == "SEALED by bench1@lab.example"
    before = {path.name: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert authorise(run, ada[0], trust, NOW) == "ada@lab.example"
    standing = standing_of(run, trust, NOW)
    assert (standing.state, standing.person) == (State.AUTHORISED, "ada@lab.example")
    assert (standing.faults, standing.remarks) == ([], [])
    shown = shown_state(run, trust, NOW).text
    assert re.fullmatch("AUTHORISED .*ada@lab.example.* bench1@lab.example", shown)
    assert fingerprint(ada[0].public_key) in standing.statements[0]
    after = {path.name: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert before.items() < after.items()
    assert set(after) - set(before) == {"SHA256SUMS.authorised.sig"}
    assert all(not mode & 0o222 for mode in modes(run).values())
    assert verify_folder(run, trust).state == "AUTHORISED"


def test_authorised_before_sealed(make_run, tmp_path, ada, trust, key):
    with make_run(tmp_path / "run") as folder:
        with pytest.raises(EvidenceError, match="not sealed"):
            authorise(folder.path, ada[0], trust, NOW)
        data = key.sign(b"no seal yet", AUTHORISATION_NAMESPACE)
        (folder.path / "SHA256SUMS.authorised.sig").write_bytes(data)
        assert ("authorisation", "SHA256SUMS.authorised.sig") in [f[:2] for f in faults(folder.path, trust)]
        assert any("authorised before sealed" in f[2] for f in faults(folder.path, trust))
        with pytest.raises(EvidenceError, match=r"SHA256SUMS\.authorised\.sig .* before"):
            seal(folder, key)


def test_the_bench_cannot_authorise(sealed, key, home, tmp_path, signers):
    both = Signer("bench1@lab.example", key.public_key)  # trusted for everything
    bench = person(home / "bench_key")[0]
    with pytest.raises(EvidenceError, match="bench's own key"):
        authorise(sealed, bench, Trust((both,)), NOW)
    other = create_key(tmp_path / "other", principal="bench2@lab.example")
    second = person(tmp_path / "other" / "bench_key")[0]
    with pytest.raises(EvidenceError, match="key of a bench"):
        authorise(sealed, second, Trust((*signers, Signer("b@l", other.public_key, (NAMESPACE,)))), NOW)
    forged = key.sign((sealed / "SHA256SUMS.sig").read_bytes(), AUTHORISATION_NAMESPACE)
    add_beside(sealed, "SHA256SUMS.authorised.sig", forged)
    trust = Trust((*signers, both))
    assert standing_of(sealed, trust, NOW).state is State.SEALED
    assert "bench's own key" in faults(sealed, trust)[0][2]


@needs_certificates
def test_only_the_named_person_authorises_a_certificate(certificate, tmp_path, ada, trust):
    bea, line = person(make_key(tmp_path, "bea"), "bea@lab.example")
    everyone = Trust((*trust.signers, line))
    with pytest.raises(EvidenceError, match="names Ada Example"):
        authorise(certificate, bea, everyone, NOW)
    copy = copied(certificate, tmp_path / "copy")
    authorise(certificate, ada[0], everyone, NOW)
    assert standing_of(certificate, everyone, NOW).state is State.AUTHORISED
    signed = bea.sign((copy / "SHA256SUMS.sig").read_bytes(), AUTHORISATION_NAMESPACE)
    (copy / "SHA256SUMS.authorised.sig").write_bytes(signed)
    assert "names Ada Example" in faults(copy, everyone)[0][2]
    assert standing_of(copy, everyone, NOW).state is State.SEALED


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"namespaces": ("git",)}, "The key is trusted for git"),
        ({"public_key": b"another"}, "not in the list of trusted keys"),
    ],
)
def test_a_key_that_may_not_authorise_now_signs_nothing(sealed, signers, ada, change, why):
    line = Signer(**{**vars(ada[1]), **change})
    before = modes(sealed)
    with pytest.raises(EvidenceError, match=why):
        authorise(sealed, ada[0], Trust((*signers, line)), NOW)
    assert modes(sealed) == before
    assert not (sealed / "SHA256SUMS.authorised.sig").exists()


DAMAGE = {
    "of another seal": lambda key, seal, _: key.sign(seal + b" ", AUTHORISATION_NAMESPACE),
    "another purpose": lambda key, seal, _: key.sign(seal, NAMESPACE),
    "no signature": lambda *_: b"yes",
    "large": lambda _, __, good: good + b"\n" * (1 << 21),
    "empty": lambda *_: b"",
}


@pytest.mark.parametrize("damage", [*DAMAGE, "link"])
def test_an_authorisation_that_does_not_hold_is_a_fault(sealed, ada, trust, damage, tmp_path):
    path = sealed / "SHA256SUMS.authorised.sig"
    authorise(sealed, ada[0], trust, NOW)
    sealed.chmod(0o755)
    path.chmod(0o644)
    if damage == "link":
        path.rename(tmp_path / "elsewhere").chmod(0o644)
        path.symlink_to(tmp_path / "elsewhere")
    else:
        seal = (sealed / "SHA256SUMS.sig").read_bytes()
        path.write_bytes(DAMAGE[damage](ada[0], seal, path.read_bytes()))
    assert [f[:2] for f in faults(sealed, trust)] == [("authorisation", "SHA256SUMS.authorised.sig")]
    assert standing_of(sealed, trust, NOW).state is State.SEALED


def test_a_seal_that_was_replaced_while_it_was_shown_is_not_signed(sealed, ada, trust):
    with pytest.raises(EvidenceError, match="replaced"):
        authorise(sealed, ada[0], trust, NOW, seal=b"what was shown")


@pytest.mark.parametrize(
    ("named", "fails"), [(False, "link"), (False, "fsync"), (False, "open"), (True, "fsync"), (True, "open")]
)
def test_a_failure_leaves_the_folder_as_it_was(sealed_once, tmp_path, monkeypatch, fails, named):
    folder = tmp_path / "run"
    shutil.copytree(sealed_once, folder)
    before = modes(folder)
    if named:
        monkeypatch.setattr(beside_seal, "write_and_link", beside_seal.write_named)
    with monkeypatch.context() as patch:
        patch.setattr(os, fails, full)
        with pytest.raises(StorageError, match="disk is full"):
            add_beside(folder, RESERVED[0], b"signature")
    assert modes(folder) == before
    add_beside(folder, RESERVED[0], b"signature")
    assert set(modes(folder)) == set(before) | {folder / RESERVED[0]}
    assert modes(folder)[folder] == before[folder]
    with pytest.raises(EvidenceError, match="never replaced"):
        add_beside(folder, RESERVED[0], b"another")
    assert (folder / RESERVED[0]).read_bytes() == b"signature"


@pytest.mark.parametrize("broken", ["list", "purpose"])
def test_an_authorisation_does_not_mend_a_seal_that_does_not_hold(sealed, ada, trust, key, broken):
    signature = sealed / "SHA256SUMS.sig"
    if broken == "purpose":
        signature.write_bytes(key.sign((sealed / "SHA256SUMS").read_bytes(), "git"))
    authorise(sealed, ada[0], trust, NOW)
    if broken == "list":
        (sealed / "SHA256SUMS").chmod(0o644)
        (sealed / "SHA256SUMS").write_text("")
    standing = standing_of(sealed, trust, NOW)
    assert (standing.state, standing.person) == (State.DRAFT, None)
    assert [(fault.kind, fault.where) for fault in standing.faults] == [("signature", "SHA256SUMS.sig")]
    assert shown_state(sealed, trust, NOW).text.startswith("DRAFT: ")


def test_a_person_who_left_stays_the_authorising_person_and_one_who_came_later_never_was(
    sealed, signers, ada
):
    authorise(sealed, ada[0], Trust((*signers, ada[1])), NOW)  # the run ended on 2026-03-01
    left = Signer(**{**vars(ada[1]), "valid_before": datetime(2026, 4, 1, tzinfo=UTC)})
    standing = standing_of(sealed, Trust((*signers, left)), NOW)
    assert standing.state is State.AUTHORISED
    assert "No trusted time stamp" in standing.remarks[0]
    gone = Signer(**{**vars(ada[1]), "valid_before": datetime(2026, 2, 1, tzinfo=UTC)})
    assert "expired 2026-02-01" in faults(sealed, Trust((*signers, gone)))[0][2]
    later = Signer(**{**vars(ada[1]), "valid_after": NOW + timedelta(days=1)})
    assert "not valid before" in faults(sealed, Trust((*signers, later)))[0][2]


def test_only_reserved_names_can_be_added_and_can_be_read_by_everybody_whatever_the_umask(sealed):
    with pytest.raises(EvidenceError, match="cannot be added"):
        add_beside(sealed, "results.json", b"{}")
    before = os.umask(0o077)
    try:
        add_beside(sealed, RESERVED[1], b"stamp")
    finally:
        os.umask(before)
    assert stat.S_IMODE((sealed / RESERVED[1]).stat().st_mode) == 0o444


@pytest.mark.parametrize(
    ("name", "text", "is_stated"),
    [
        ("certificate.json", '{"issued_utc": "2026-03-02T01:00:00+01:00"}', True),
        ("certificate.json", '{"issued_utc": "2026-03-02T00:00:00"}', False),
        ("certificate.json", '{"issued_utc": 7}', False),
        ("certificate.json", "[" * 100_000, False),
        ("results.json", '{"run": {"calibrated_utc": "2026-03-02T00:00:00.000Z"}}', True),
        ("results.json", '{"run": []}', False),
        ("journal.jsonl", '{"utc": "x"}\n{"utc": "2026-03-02T00:00:00Z"}\n', True),
        ("journal.jsonl", '{"utc": "2026-03-02T00:00:00Z"}\n{"ut', False),
        ("journal.jsonl", "", False),
    ],
)
def test_the_time_that_a_folder_states(tmp_path, name, text, is_stated):
    (tmp_path / name).write_text(text)
    assert stated_time(tmp_path) == (datetime(2026, 3, 2, tzinfo=UTC) if is_stated else None)


def test_a_link_of_a_folder_is_not_followed_for_its_time(tmp_path):
    """It may lead to what never ends, such as the log of the kernel, which the system calls a file."""
    (tmp_path / "endless").write_text('{"utc": "2026-03-02T00:00:00Z"}\n')
    (tmp_path / "journal.jsonl").symlink_to("endless")
    assert stated_time(tmp_path) is None
