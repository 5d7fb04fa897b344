"""The seal: what stock programs make of it, and what it refuses."""

import base64
import os
import subprocess

import pytest
from authorising import needs_ssh_keygen
from hypothesis import given
from hypothesis import strategies as st
from refusals import denied

from bench.base.errors import EvidenceError, StorageError
from bench.evidence.seal import make_manifest, read_manifest, seal
from bench.evidence.ssh_keys import string, strings
from bench.evidence.sshsig import is_valid, read_signature
from bench.record.journal import Journal
from bench.run.launch import seal_finished

# ------------------------------------------------------------------ signatures


@needs_ssh_keygen
@pytest.mark.parametrize("message", [b"", b"abc", b"x" * 100_000], ids=len)
def test_a_signature_is_byte_for_byte_that_of_ssh_keygen(home, key, tmp_path, message):
    (tmp_path / "m").write_bytes(message)
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", home / "bench_key", "-n", "some-thing@v1"]
    command += [tmp_path / "m"]
    subprocess.run(command, check=True, capture_output=True)
    assert key.sign(message, "some-thing@v1") == (tmp_path / "m.sig").read_bytes()


@given(data=st.data())
def test_a_changed_signature_is_refused_or_does_not_hold(key, data):
    good = bytearray(key.sign(b"message", "a@v1"))
    at = data.draw(st.integers(0, len(good) - 1))
    value = data.draw(st.integers(0, 255).filter(lambda v: v != good[at]))
    changed = bytes(good[:at] + bytes([value]) + good[at + 1 :])
    try:
        signature = read_signature(changed)
    except EvidenceError:
        return
    # base64 has spare bits and the armour's line ends may change; then it is the very same signature
    assert not is_valid(signature, b"message") or signature == read_signature(bytes(good))


def repacked(armoured, change):
    """A signature whose five strings (key, namespace, reserved, hash, signature) were changed."""
    blob = base64.b64decode(b"".join(armoured.splitlines()[1:-1]))
    parts, _ = strings(blob[10:], 5)
    lines = base64.b64encode(blob[:10] + b"".join(map(string, change(parts))))
    return b"-----BEGIN SSH SIGNATURE-----\n" + lines + b"\n-----END SSH SIGNATURE-----\n"


CHANGES = {
    "reserved": lambda s: [*s[:2], b"reserved", *s[3:]],
    "hash": lambda s: [*s[:3], b"md5", s[4]],
    "more": lambda s: [*s, b"more"],
    "key too long": lambda s: [s[0] + b"\0", *s[1:]],
    "key type": lambda s: [s[0].replace(b"ed25519", b"ed25518"), *s[1:]],
    "signature too short": lambda s: [*s[:4], s[4][:-1]],
    "signature type": lambda s: [*s[:4], s[4].replace(b"ed25519", b"ed25518")],
    "no signature": lambda s: s[:4],
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_signature_of_another_form_is_refused(key, change):
    armoured = key.sign(b"message", "a@v1")
    assert read_signature(repacked(armoured, list)) == read_signature(armoured)
    with pytest.raises(EvidenceError, match="not a signature"):
        read_signature(repacked(armoured, CHANGES[change]))


# ------------------------------------------------------------------ the sealed folder


def test_what_the_seal_lists_is_on_the_disk_before_it(make_run, key, tmp_path, synced):
    with make_run(tmp_path / "run") as folder:
        written_by_others = [folder.path / "wire.jsonl", folder.path / "quarantine" / "a.raw.part.1"]
        written_by_others[1].parent.mkdir()
        for path in written_by_others:
            path.write_text("not synced by whoever wrote it")
        synced.clear()
        seal(folder, key)
    before = synced[: synced.index(tmp_path / "run" / ".SHA256SUMS.tmp")]
    assert set(written_by_others) <= set(before)


@pytest.mark.parametrize(
    "strange", ["link", "folder link", "pipe", "line\nfeed", "back\\slash", "no journal"]
)
def test_what_cannot_be_listed_is_not_sealed(make_run, key, tmp_path, strange):
    with make_run(tmp_path / "run") as folder:
        path = folder.path / "exports" / strange
        if strange == "pipe":
            os.mkfifo(path)
        elif "link" in strange:
            path.symlink_to(tmp_path if strange == "folder link" else folder.path / "results.json")
        elif strange == "no journal":
            folder.journal_path.unlink()
        else:
            path.write_text("")
        with pytest.raises(
            EvidenceError, match="no journal" if strange == "no journal" else "cannot be sealed"
        ):
            seal(folder, key)
        assert not (folder.path / "SHA256SUMS.sig").exists()


def test_a_folder_that_cannot_be_read_is_not_passed_over(tmp_path, monkeypatch):
    (tmp_path / "exports").mkdir()
    real = os.scandir

    def scandir(path):
        if str(path).endswith("exports"):
            denied(path)
        return real(path)

    monkeypatch.setattr(os, "scandir", scandir)
    with pytest.raises(StorageError, match="exports: No permission"):
        make_manifest(tmp_path)


H = "0" * 64


@pytest.mark.parametrize(
    "text",
    [
        f"{H} a\n",
        f"{H} *a\n",
        f"{H[:-1]}  a\n",
        f"{H[:-1]}G  a\n",
        f"{H}  ../a\n",
        f"{H}  /etc/passwd\n",
        f"{H}  a/./b\n",
        f"{H}  b\n{H}  a\n",
        f"{H}  a\n{H}  a\n",
        f"{H}  SHA256SUMS\n",
        f"{H}  a\nrest",
        f"\\{H}  a\\nb\n",
        "\n",
    ],
)
def test_a_list_that_is_not_one_of_ours_is_refused(text):
    with pytest.raises(EvidenceError, match=r"SHA256SUMS:\d: This line"):
        read_manifest(text.encode())


def test_a_finished_run_without_results_is_sealed_when_it_is_taken_up_again(make_run, key, tmp_path):
    with make_run(tmp_path / "run") as folder:
        (folder.path / "results.json").unlink()
        with Journal.open(folder.journal_path, None) as journal:
            end = seal_finished(folder, journal, key)
    assert (end.how, end.outcome) == ("finished", None)
    assert (tmp_path / "run" / "SHA256SUMS.sig").exists()
