"""VERIFY.txt of each kind of folder: its commands, taken literally, by stock programs alone."""

import json
import re
import shutil
import subprocess
from datetime import UTC, datetime

import pytest
from authorising import needs_certificates, needs_openssl, needs_ssh_keygen
from unchecked_seal import seal_unchecked

from bench.evidence.authorisation import authorise
from bench.evidence.beside_seal import add_beside
from bench.evidence.folder_kinds import folder_kind
from bench.evidence.key_trust import Trust
from bench.evidence.seal import make_manifest
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.verify import verify_folder
from tests.unit.bench.evidence.resealed import kinds, reseal, writable

pytest.importorskip("rfc3161_client", reason="the extra `certificate` is not installed")
pytestmark = [needs_ssh_keygen, needs_openssl]

NOW = datetime.now(UTC)
MARKERS = {"run": "journal.jsonl", "certificate": "certificate.json", "results": "sources.json"}
KINDS = ["run", pytest.param("certificate", marks=needs_certificates), "results", "files"]


@pytest.fixture
def lists(tmp_path, home, ada, authority):
    """The files that a stranger gets from the laboratory in another way."""
    folder = tmp_path / "lists"
    folder.mkdir()
    own = (home / "allowed_signers").read_text()
    (folder / "allowed_signers").write_text(f"{own}{ada[1].line}\n")
    (folder / "revoked_keys").write_text("")
    shutil.copy(authority.root, folder / "tsa_certificates.pem")
    return folder


def make_folder(path, key, kind, ada):
    path.mkdir()
    named = {"name": "Ada", "role": "head", "key_fingerprint": fingerprint(ada.public_key)}
    marker = MARKERS.get(kind, "any.txt")
    (path / marker).write_text(json.dumps({"authorised_by": named}) + "\n")
    (path / "exports").mkdir()
    (path / "exports" / "opencv.yaml").write_text("fx: 1\n")
    assert folder_kind(path).name == kind
    seal_unchecked(path, key)
    return path


def commands_of(folder):
    """The commands of VERIFY.txt, each as one line."""
    text = (folder / "VERIFY.txt").read_text()
    lines = re.sub(r"\\\n\s+", "", "".join(re.findall(r"^ {4}.+\n", text, re.MULTILINE))).splitlines()
    return [line.strip() for line in lines if not line.strip().startswith("SHA256:")]


def run(command, folder, lists, who="ada@lab.example"):
    command = re.sub(r" (allowed_signers|revoked_keys|tsa_certificates\.pem)", rf" {lists}/\1", command)
    command = command.replace("-I PERSON", f"-I {who}")
    done = subprocess.run(["sh", "-c", command], cwd=folder, capture_output=True, check=False, text=True)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("kind", KINDS)
def test_every_command_succeeds_on_an_authorised_and_stamped_folder(
    tmp_path, key, signers, kind, ada, lists, authority
):
    from bench.evidence.tsa_client import make_request

    folder = make_folder(tmp_path / kind, key, kind, ada[0])
    authorise(folder, ada[0], Trust((*signers, ada[1])), NOW)
    for name in ("SHA256SUMS", "SHA256SUMS.authorised"):
        request = make_request((folder / f"{name}.sig").read_bytes(), nonce=False).data
        add_beside(folder, f"{name}.tsr", authority.reply(request))
    commands = commands_of(folder)
    assert len(commands) == 9
    answers = [run(command, folder, lists) for command in commands]
    assert [status for status, _ in answers] == [0] * 9, answers
    seal, hashes, complete, names, authorised, stamp, time, *_ = (text for _, text in answers)
    assert "bench1@lab.example" in seal
    assert (hashes, complete) == ("", "complete\n")
    assert names == "ada@lab.example\n"
    assert fingerprint(ada[0].public_key) in authorised
    assert "Verification: OK" in stamp
    assert "Time stamp: " in time
    for more in (f" -O verify-time={NOW:%Y%m%d%H%M%S}Z", " -r revoked_keys"):
        assert run(commands[0].replace(" -s ", f"{more} -s "), folder, lists)[0] == 0


@needs_certificates
def test_the_commands_find_what_is_wrong(tmp_path, key, signers, ada, lists, authority):
    from bench.evidence.tsa_client import make_request

    folder = make_folder(tmp_path / "f", key, "certificate", ada[0])
    authorise(folder, ada[0], Trust((*signers, ada[1])), NOW)
    add_beside(folder, "SHA256SUMS.tsr", authority.reply(make_request(b"another seal", nonce=False).data))
    seal, hashes, complete, names, authorised, stamp, *_ = commands_of(folder)
    assert run(stamp, folder, lists)[0] != 0
    assert run(authorised, folder, lists, "bench1@lab.example")[0] != 0
    folder.chmod(0o755)
    (folder / "SHA256SUMS.authorised.sig.sig").write_text("beside, but not reserved")
    assert run(complete, folder, lists) == (1, "")
    (folder / "SHA256SUMS.authorised.sig.sig").unlink()
    (folder / "exports").chmod(0o755)
    (folder / "exports" / "SHA256SUMS.tsr").write_text("reserved beside the seal only")
    assert run(complete, folder, lists) == (1, "")
    (lists / "revoked_keys").write_text(f"{key.public_text}\n")
    assert run(seal.replace(" -s ", " -r revoked_keys -s "), folder, lists)[0] != 0
    shutil.copy(folder / "SHA256SUMS.sig", folder / "copy")
    (folder / "SHA256SUMS.authorised.sig").chmod(0o644)
    (folder / "SHA256SUMS.authorised.sig").write_bytes((folder / "copy").read_bytes())
    assert run(authorised, folder, lists)[0] != 0
    assert run(names, folder, lists)[0] == 0  # it names the bench: the second command refuses
    assert run(hashes, folder, lists)[0] == 0
    (folder / "exports" / "opencv.yaml").chmod(0o644)
    (folder / "exports" / "opencv.yaml").write_text("fx: 2\n")
    assert run(hashes, folder, lists)[0] == 1
    (folder / "SHA256SUMS").chmod(0o644)
    (folder / "SHA256SUMS").write_bytes(make_manifest(folder))
    assert run(hashes, folder, lists)[0] == 0
    assert run(seal, folder, lists)[0] == 255


@pytest.mark.parametrize("kind", KINDS)
def test_other_instructions_are_a_fault_in_every_kind_of_folder(tmp_path, key, signers, ada, kind):
    folder = writable(make_folder(tmp_path / kind, key, kind, ada[0]))
    assert ("instructions", "VERIFY.txt") not in kinds(verify_folder(folder, signers))
    text = (folder / "VERIFY.txt").read_text()
    (folder / "VERIFY.txt").write_text(text.replace(f"-I {key.principal} ", "-I a;$(rm${IFS}*) ", 1))
    reseal(folder, key)
    assert ("instructions", "VERIFY.txt") in kinds(verify_folder(folder, signers))


@needs_certificates
@pytest.mark.parametrize("name", ["plots/more.svg", "plots/coverage.svg"])
def test_a_certificate_has_the_plots_that_one_is_drawn_with_and_no_others(tmp_path, key, signers, ada, name):
    folder = writable(make_folder(tmp_path / "certificate", key, "certificate", ada[0]))
    (folder / name).parent.mkdir()
    (folder / name).write_text("<svg></svg>")
    reseal(folder, key)
    assert (("kind", name) in kinds(verify_folder(folder, signers))) == (name == "plots/more.svg")
