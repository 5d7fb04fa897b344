"""Keys of persons: what ssh-keygen signs is verified here and the other way round, for each type of key."""

import base64
import hashlib
import os
import shutil
import subprocess
from contextlib import suppress

import pytest
from authorising import KEY_KINDS, armoured, make_key, needs_ssh_keygen
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature
from hypothesis import given
from hypothesis import strategies as st

from bench.base.errors import EvidenceError, StorageError
from bench.evidence.openssh import NotInstalled
from bench.evidence.personal_key import find_key, load_file_key
from bench.evidence.ssh_keys import check_key, encode_public_key, string
from bench.evidence.sshsig import Ed25519Signer, is_valid, read_signature


def no_passphrase(path):
    raise AssertionError(f"nobody should be asked for the passphrase of {path}")


def signed_by_openssh(path, message, namespace):
    folder = path.parent
    (folder / "message").write_bytes(message)
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", path, "-n", namespace, folder / "message"]
    subprocess.run(command, check=True, capture_output=True)
    return (folder / "message.sig").read_bytes()


@needs_ssh_keygen
@pytest.mark.parametrize("kind", KEY_KINDS)
def test_a_signature_of_ssh_keygen_is_valid_here_and_ours_there(tmp_path, kind):
    path = make_key(tmp_path, kind=kind)
    theirs = read_signature(signed_by_openssh(path, b"what is signed", "a@v1"))
    assert is_valid(theirs, b"what is signed")
    assert not is_valid(theirs, b"what is Signed")

    ours = load_file_key(path, no_passphrase).sign(b"what is signed", "a@v1")
    assert read_signature(ours).public_key == theirs.public_key
    (tmp_path / "ours.sig").write_bytes(ours)
    public = path.with_suffix(".pub").read_text()
    (tmp_path / "signers").write_text(f"ada@lab {public}")
    command = ["ssh-keygen", "-Y", "verify", "-f", "signers", "-I", "ada@lab", "-n", "a@v1", "-s", "ours.sig"]
    subprocess.run(command, input=b"what is signed", cwd=tmp_path, check=True, capture_output=True)


@needs_ssh_keygen
@pytest.mark.parametrize("kind", ["ed25519", "nistp256", "rsa"])
def test_a_key_in_pem_signs(tmp_path, kind):
    private = serialization.load_ssh_private_key(make_key(tmp_path, kind=kind).read_bytes(), password=None)
    pem = (serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    path = tmp_path / "key.pem"
    path.write_bytes(private.private_bytes(*pem))
    path.chmod(0o600)
    assert is_valid(read_signature(load_file_key(path, no_passphrase).sign(b"message", "a@v1")), b"message")


@needs_ssh_keygen
def test_a_key_that_others_can_read_or_that_is_none_is_refused(tmp_path):
    path = make_key(tmp_path)
    path.chmod(0o640)
    with pytest.raises(EvidenceError, match="chmod 600"):
        load_file_key(path, no_passphrase)
    path.chmod(0o600)
    path.write_text("-----BEGIN OPENSSH PRIVATE KEY-----\nbm90aGluZw==\n-----END OPENSSH PRIVATE KEY-----\n")
    with pytest.raises(EvidenceError, match="cannot be used"):
        load_file_key(path, no_passphrase)
    os.mkfifo(tmp_path / "pipe", 0o600)
    for read in (load_file_key, lambda path, ask: find_key(str(path), None, ask)):
        with pytest.raises(StorageError, match="a pipe"):
            read(tmp_path / "pipe", no_passphrase)


@needs_ssh_keygen
def test_without_openssh_a_computer_checks_ed25519_and_says_what_it_needs_for_the_rest(tmp_path, monkeypatch):
    mine = read_signature(Ed25519Signer(_KEY).sign(b"message", "a@v1"))
    theirs = read_signature(signed_by_openssh(make_key(tmp_path, kind="rsa"), b"message", "a@v1"))
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    assert is_valid(mine, b"message")
    with pytest.raises(NotInstalled, match="ssh-keygen of OpenSSH"):
        is_valid(theirs, b"message")


def signed_data(message, namespace="a@v1"):
    digest = hashlib.sha512(message).digest()
    return b"SSHSIG" + b"".join(map(string, (namespace.encode(), b"", b"sha512", digest)))


def mpint(number):
    return string(number.to_bytes(number.bit_length() // 8 + 1, "big"))


def token_signature(key, public, message, flags=1, application=b"ssh:"):
    """Sign as a security token does (PROTOCOL.u2f)."""
    data = hashlib.sha256(application).digest() + bytes([flags]) + (7).to_bytes(4, "big")
    data += hashlib.sha256(signed_data(message)).digest()
    kind = public[4 : 4 + int.from_bytes(public[:4], "big")]
    if isinstance(key, Ed25519PrivateKey):
        made = key.sign(data)
    else:
        made = b"".join(map(mpint, decode_dss_signature(key.sign(data, ec.ECDSA(hashes.SHA256())))))
    return string(kind) + string(made) + bytes([flags]) + (7).to_bytes(4, "big")


def token_keys():
    plain = Ed25519PrivateKey.generate()
    raw = string(plain.public_key().public_bytes_raw())
    yield plain, string(b"sk-ssh-ed25519@openssh.com") + raw + string(b"ssh:")
    curve = ec.generate_private_key(ec.SECP256R1())
    point = curve.public_key().public_bytes(
        serialization.Encoding.X962, serialization.PublicFormat.UncompressedPoint
    )
    kind = string(b"sk-ecdsa-sha2-nistp256@openssh.com") + string(b"nistp256")
    yield curve, kind + string(point) + string(b"ssh:")


@needs_ssh_keygen
@pytest.mark.parametrize(("key", "public"), list(token_keys()), ids=["ed25519", "ecdsa"])
def test_a_security_token_signs_only_when_touched(key, public):
    def valid(message, **how):
        signature = token_signature(key, public, b"data", **how)
        return is_valid(read_signature(armoured(public, signature)), message)

    assert valid(b"data")
    assert not valid(b"other data")
    assert not valid(b"data", flags=0)
    assert not valid(b"data", application=b"web:")


@needs_ssh_keygen
def test_short_rsa_keys_and_sha_1_are_refused():
    openssh = (serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH)
    short, key = (rsa.generate_private_key(65537, size) for size in (1024, 2048))
    blobs = [
        base64.b64decode(private.public_key().public_bytes(*openssh).split()[1]) for private in (short, key)
    ]
    with pytest.raises(ValueError, match="2048"):
        check_key(blobs[0])
    signed = key.sign(signed_data(b"data"), padding.PKCS1v15(), hashes.SHA1())
    with pytest.raises(EvidenceError, match="rsa-sha2-512"):
        read_signature(armoured(blobs[1], string(b"ssh-rsa") + string(signed)))


@given(st.binary(max_size=300))
def test_any_bytes_are_a_key_or_a_value_error(data):
    kinds = (b"ssh-ed25519", b"ssh-rsa", b"ecdsa-sha2-nistp256")
    for blob in (data, *(string(kind) + data for kind in kinds)):
        with suppress(ValueError):
            check_key(blob)
            assert blob.startswith(string(b"ssh-"))


_KEY = Ed25519PrivateKey.generate()
_PUBLIC = encode_public_key(_KEY.public_key())


@given(st.binary(max_size=300))
def test_any_bytes_are_no_signature(data):
    for blob in (data, string(b"ssh-ed25519") + data, string(b"ssh-ed25519") + string(data)):
        with suppress(EvidenceError):
            assert not is_valid(read_signature(armoured(_PUBLIC, blob)), b"data")
