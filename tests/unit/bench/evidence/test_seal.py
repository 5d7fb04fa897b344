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
from bench.base.failure import Failure
from bench.evidence.seal import make_manifest, read_manifest, seal
from bench.evidence.ssh_keys import string, strings
from bench.evidence.sshsig import is_valid, read_signature
from bench.evidence.verify import verify_folder
from bench.record.journal import Journal
from bench.record.run_folder import is_sealed
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
    "strange",
    ["link", "folder link", "pipe", "line\nfeed", "back\\slash", os.fsdecode(b"Dr\374cken.txt"), "moved"],
)
def test_what_cannot_be_listed_is_not_sealed(make_run, key, tmp_path, strange):
    with make_run(tmp_path / "run") as folder:
        path = folder.path / "exports" / strange
        if strange == "pipe":
            os.mkfifo(path)
        elif "link" in strange:
            path.symlink_to(tmp_path if strange == "folder link" else folder.path / "results.json")
        elif strange == "moved":
            folder.path.rename(tmp_path / "elsewhere")
        else:
            path.write_text("")
        with pytest.raises(EvidenceError, match="was moved" if strange == "moved" else "cannot be sealed"):
            seal(folder, key)
        assert not (folder.path / "SHA256SUMS.sig").exists()


@pytest.fixture
def refused_seal(make_run, key, tmp_path):
    """What changes a run before it is sealed, and returns the refusal of its seal."""

    def refused(change):
        with make_run(tmp_path / "run") as folder:
            change(folder.path)
            with pytest.raises(EvidenceError) as refusal:
                seal(folder, key)
        assert not is_sealed(folder.path)
        assert not (folder.path / "SHA256SUMS").exists()
        return Failure.of(refusal.value).message

    return refused


@pytest.mark.parametrize("name", ["notes.txt", "exports/more.yaml", "captures/pose-009-attempt-1.raw"])
def test_a_stray_file_is_named_before_the_seal_and_the_way_on_is_told(refused_seal, tmp_path, name):
    message = refused_seal(lambda run: (run / name).write_text("the lamp was warm"))
    assert f"verified. {name}: " in message
    assert f"seal it: `starbench resume {tmp_path / 'run'}`" in message


def test_a_run_whose_stray_file_was_moved_out_is_sealed_and_verified(make_run, key, signers, tmp_path):
    with make_run(tmp_path / "run") as folder:
        (folder.path / "notes.txt").write_text("the lamp was warm")
        with pytest.raises(EvidenceError, match=r"notes\.txt: no run folder has this file"):
            seal(folder, key)
        (folder.path / "notes.txt").rename(tmp_path / "notes.txt")
        seal(folder, key)
    assert verify_folder(tmp_path / "run", signers).ok


@pytest.mark.parametrize("name", ["captures/pose-002-attempt-1.raw", "results.json", "plan.json", "views.h5"])
def test_a_run_that_lacks_what_its_journal_names_is_not_sealed_and_a_new_run_is_advised(refused_seal, name):
    message = refused_seal(lambda run: (run / name).unlink())
    assert f"{name}: the journal names this file; it is missing" in message
    assert "make a new run: starbench run " in message


def test_a_run_with_a_recording_that_was_changed_is_not_sealed(refused_seal):
    message = refused_seal(lambda run: (run / "captures/pose-002-attempt-1.raw").write_bytes(b"changed"))
    assert "pose-002-attempt-1.raw: the journal names this file with another hash" in message


@pytest.mark.parametrize("cut", ["the last line", "the first line", "half a line"])
def test_a_run_whose_journal_was_cut_is_not_sealed(refused_seal, cut):
    def change(run):
        path = run / "journal.jsonl"
        lines = path.read_bytes().splitlines(keepends=True)
        left = {"the last line": lines[:-1], "the first line": lines[1:], "half a line": [*lines[:-1], b"{"]}
        path.write_bytes(b"".join(left[cut]))

    assert "verified. journal.jsonl" in refused_seal(change)


def test_of_many_files_that_are_missing_a_screen_is_told(refused_seal):
    message = refused_seal(lambda run: [(run / f"{number}.txt").touch() for number in range(9)])
    assert "4.txt: no run folder has this file. And 4 more." in message


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
        *(
            f"{H} {name}\n"
            for name in ("a", "*a", " ../a", " /etc/passwd", " a/./b", " SHA256SUMS", " a\nrest")
        ),
        *(f"{H[:-1]}{odd}  a\n" for odd in ("", "G")),
        *(f"{H}  {first}\n{H}  a\n" for first in "ab"),
        f"\\{H}  a\\nb\n",
        "\n",
    ],
)
def test_a_list_that_is_not_one_of_ours_is_refused(text):
    with pytest.raises(EvidenceError, match=r"SHA256SUMS:\d: This line"):
        read_manifest(text.encode())


def test_a_finished_run_without_results_is_sealed_when_it_is_taken_up_again(make_run, key, tmp_path):
    with (
        make_run(tmp_path / "run", reported=False) as folder,
        Journal.open(folder.journal_path, None) as journal,
    ):
        end = seal_finished(folder, journal, key)
    assert (end.how, end.outcome) == ("finished", None)
    assert (tmp_path / "run" / "SHA256SUMS.sig").exists()
