"""Verification: the untouched bundle passes, each way of tampering with it is found and named."""

import json
import os
import re
import shutil

import pytest
from unchecked_seal import seal_unchecked

from bench.base.errors import RunFolderError
from bench.evidence.keys import create_key
from bench.evidence.seal import make_manifest, seal, seal_folder
from bench.evidence.signers import NAMESPACE
from bench.evidence.verify import verify_folder
from tests.unit.bench.evidence.resealed import copied, kinds, reseal


def test_the_untouched_bundle_passes(sealed_once, signers, key):
    verification = verify_folder(sealed_once, signers, camera_serial="00050423")
    assert verification.ok
    assert verification.signer == "bench1@lab.example"
    assert verification.fingerprint == key.fingerprint
    assert (verification.run_id, verification.camera_serial) == ("run-1", "00050423")
    assert verification.simulated
    assert verification.files == 12


@pytest.mark.parametrize(
    "name", ["captures/pose-003-attempt-1.raw", ".hidden", "exports/.x/y", "SHA256SUMS.sig2"]
)
def test_an_added_file_is_found(sealed, signers, name):
    (sealed / name).parent.mkdir(exist_ok=True)
    (sealed / name).write_text("added")
    assert kinds(verify_folder(sealed, signers)) == [("added", name)]


def test_a_missing_file_is_found(sealed, signers):
    (sealed / "results.json").unlink()
    (fault,) = verify_folder(sealed, signers).to_dict()["faults"]
    assert fault == {"kind": "missing", "where": "results.json", "what": "the file is missing"}


# ------------------------------------------------------------------ attacks


def test_a_list_made_again_under_the_old_signature_is_found(sealed, signers):
    (sealed / "results.json").write_bytes((sealed / "results.json").read_bytes().replace(b"run-1", b"run-2"))
    (sealed / "SHA256SUMS").write_bytes(make_manifest(sealed))
    faults = kinds(verify_folder(sealed, signers))
    assert faults == [("results", "results.json"), ("signature", "SHA256SUMS.sig")]


def test_a_bundle_signed_by_another_key_is_found(sealed, signers, tmp_path):
    other_key = create_key(tmp_path / "other", principal="mallory@lab.example")
    (sealed / "exports/opencv.yaml").write_text("fx: 1\n")
    reseal(sealed, other_key)
    verification = verify_folder(sealed, signers)
    assert ("key", "SHA256SUMS.sig") in kinds(verification)
    assert ("instructions", "VERIFY.txt") in kinds(verification)
    assert other_key.fingerprint in verification.faults[0].what
    assert verification.signer is None


def test_a_report_passed_off_for_another_camera_is_found(make_run, key, signers, tmp_path):
    with make_run(tmp_path / "run", serial="00050999") as folder:
        seal(folder, key)
    verification = verify_folder(tmp_path / "run", signers, camera_serial="00050423")
    assert kinds(verification) == [("item", "results.json")]
    assert re.search("00050999.* 00050423", str(verification.faults[0]))


@pytest.mark.parametrize("target", ["copy", "nowhere"])
def test_a_link_in_place_of_a_file_is_found(sealed, signers, tmp_path, target):
    capture = sealed / "captures/pose-001-attempt-1.raw"
    shutil.move(capture, tmp_path / "copy")
    capture.symlink_to(tmp_path / target)
    assert kinds(verify_folder(sealed, signers)) == [("link", "captures/pose-001-attempt-1.raw")]


@pytest.mark.parametrize("name", ["SHA256SUMS", "SHA256SUMS.sig"])
@pytest.mark.parametrize("linked", [False, True])
def test_a_seal_that_was_stripped_or_is_a_link_is_none(sealed, signers, tmp_path, name, linked):
    shutil.move(sealed / name, tmp_path / "elsewhere")
    if linked:
        (sealed / name).symlink_to(tmp_path / "elsewhere")
    verification = verify_folder(sealed, signers)
    assert kinds(verification) == [("unsealed", name)]
    assert verification.state == "DRAFT"
    assert json.loads(json.dumps(verification.to_dict()))["ok"] is False


def test_a_listed_path_that_leads_out_is_found(sealed, signers, key):
    manifest = b"0" * 64 + b"  ../../etc/passwd\n" + (sealed / "SHA256SUMS").read_bytes()
    (sealed / "SHA256SUMS").write_bytes(manifest)
    (sealed / "SHA256SUMS.sig").write_bytes(key.sign(manifest, NAMESPACE))
    assert ("manifest", "SHA256SUMS:1") in kinds(verify_folder(sealed, signers))


def test_nobody_trusted_means_not_verified(sealed_once):
    assert [f.kind for f in verify_folder(sealed_once, []).faults] == ["key"]


def test_an_endless_seal_is_not_read(sealed, signers):
    os.truncate(sealed / "SHA256SUMS", 1 << 30)
    assert ("manifest", "SHA256SUMS") in kinds(verify_folder(sealed, signers))


# ------------------------------------------------------------------ what the bench itself may have got wrong


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda _: b"[]", "the file cannot be read"),
        (lambda data: data.replace(b'"id": "run-1"', b'"id": "run-2", "id": "run-1"'), "'id' is there twice"),
        (lambda data: data.replace(b'"id"', b'"\\u0069d"'), "not written as the program writes it"),
        (lambda data: data.replace(b'"index": 1', b'"index": 1e999'), "not written as the program writes it"),
        (lambda data: data.replace(b'"index": 1', b'"index": 1' + b"0" * 5000), "limit"),
        (lambda _: b" " * 100_000_001, "he file has more than 100000000 bytes"),
    ],
    ids=["no JSON", "key twice", "escaped key", "infinite", "digits", "bytes"],
)
def test_results_that_are_none_or_could_be_read_in_two_ways_are_found(sealed, signers, key, change, what):
    path = sealed / "results.json"
    path.write_bytes(change(path.read_bytes()))
    reseal(sealed, key)
    faults = [fault.what for fault in verify_folder(sealed, signers).faults if fault.where == "results.json"]
    assert any(what in fault for fault in faults), faults


@pytest.mark.parametrize(
    "name",
    ["report-final.html", "exports2/opencv.yaml", "exports/more.yaml", ".hidden/x", "report\u200b.html"],
)
def test_a_sealed_file_that_no_run_folder_has_is_named(sealed, key, signers, name):
    (sealed / name).parent.mkdir(exist_ok=True)
    (sealed / name).write_text("added before the seal")
    reseal(sealed, key)
    verification = verify_folder(sealed, signers)
    assert ("kind", name) in kinds(verification)


def test_of_a_folder_of_another_kind_only_the_seal_is_verified_and_that_is_told(tmp_path, key, signers):
    (tmp_path / "passport.txt").write_text("R 255 mm")
    seal_folder(tmp_path, key)
    verification = verify_folder(tmp_path, signers, derivations=[])
    assert (verification.kind, verification.ok, verification.complete) == ("files", True, False)
    assert verify_folder(tmp_path, signers).complete  # nothing was to be derived


@pytest.mark.parametrize("name", ["results.json", "report.html", "plan.json", "station.yaml"])
def test_files_of_a_run_without_a_journal_are_found(tmp_path, key, signers, name):
    (tmp_path / name).write_text("{}")
    seal_unchecked(tmp_path, key)
    assert ("kind", "journal.jsonl") in kinds(verify_folder(tmp_path, signers))


def test_what_is_no_run_folder_is_an_error(tmp_path):
    for path in (tmp_path, tmp_path / "absent"):
        with pytest.raises(RunFolderError, match="not a run folder"):
            verify_folder(path, [])


# ------------------------------------------------------------------ each file


DAMAGE = {
    "changed": lambda data: data[: (at := len(data) // 2)] + bytes([data[at] ^ 0x80]) + data[at + 1 :],
    "cut": lambda data: data[: len(data) // 2],
    "longer": lambda data: data + b"x",
    "empty": lambda _data: b"",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_of_whichever_file_is_found_and_told_without_a_crash(sealed_once, signers, tmp_path, damage):
    folder = copied(sealed_once, tmp_path / "run")
    for path in [path for path in folder.rglob("*") if path.is_file()]:
        data = path.read_bytes()
        path.write_bytes(DAMAGE[damage](data))
        verification = verify_folder(folder, signers)
        assert verification.ok is (path.read_bytes() == data), path
        json.dumps(verification.to_dict())
        path.write_bytes(data)
    assert verify_folder(folder, signers).ok
