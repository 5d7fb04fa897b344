"""Keys of persons: what ssh-keygen signs is verified here and the other way round, for each type of key."""

import hashlib
import subprocess

import pytest
from authorising import KEY_KINDS, make_key, needs_ssh_keygen
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from bench.base.errors import EvidenceError
from bench.evidence.person_key import load_file_key
from bench.evidence.ssh_keys import PublicKey, encode_ecdsa_signature, encode_public_key
from bench.evidence.ssh_wire import Reader, encode_mpint, mpint, string
from bench.evidence.sshsig import is_valid, read_signature, sign_with


def no_passphrase(path):
    raise AssertionError(f"nobody should be asked for the passphrase of {path}")


@needs_ssh_keygen
@pytest.mark.parametrize("kind", KEY_KINDS)
def test_a_signature_of_ssh_keygen_is_valid_here_and_ours_there(tmp_path, kind):
    path = make_key(tmp_path, kind=kind)
    message = tmp_path / "message"
    message.write_bytes(b"what is signed")
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", path, "-n", "a@v1", message]
    subprocess.run(command, check=True, capture_output=True)
    theirs = read_signature((tmp_path / "message.sig").read_bytes())
    assert is_valid(theirs, b"what is signed")
    assert not is_valid(theirs, b"what is Signed")

    ours = sign_with(load_file_key(path, no_passphrase), b"what is signed", "a@v1")
    assert read_signature(ours).public_key == theirs.public_key
    (tmp_path / "ours.sig").write_bytes(ours)
    public = path.with_suffix(".pub").read_text()
    (tmp_path / "signers").write_text(f"ada@lab {public}")
    command = ["ssh-keygen", "-Y", "verify", "-f", "signers", "-I", "ada@lab", "-n", "a@v1", "-s", "ours.sig"]
    subprocess.run(command, input=b"what is signed", cwd=tmp_path, check=True, capture_output=True)


@needs_ssh_keygen
def test_a_protected_key_needs_its_passphrase(tmp_path):
    path = make_key(tmp_path, passphrase="a secret")
    assert load_file_key(path, lambda _: b"a secret").public_key
    with pytest.raises(EvidenceError, match="the passphrase is wrong"):
        load_file_key(path, lambda _: b"another")


@needs_ssh_keygen
def test_a_key_that_others_can_read_or_that_is_none_is_refused(tmp_path):
    path = make_key(tmp_path)
    path.chmod(0o640)
    with pytest.raises(EvidenceError, match="Other users can read the key"):
        load_file_key(path, no_passphrase)
    path.chmod(0o600)
    path.write_text("-----BEGIN OPENSSH PRIVATE KEY-----\nbm90aGluZw==\n-----END OPENSSH PRIVATE KEY-----\n")
    with pytest.raises(EvidenceError, match="cannot be used"):
        load_file_key(path, no_passphrase)


def token_signature(key, public, data, flags=1, application=b"ssh:"):
    """Sign as a security token does (PROTOCOL.u2f)."""
    signed = hashlib.sha256(application).digest() + bytes([flags]) + (7).to_bytes(4, "big")
    signed += hashlib.sha256(data).digest()
    kind = Reader(public).string()
    if isinstance(key, Ed25519PrivateKey):
        signature = string(kind) + string(key.sign(signed))
    else:
        signature = encode_ecdsa_signature(kind, key.sign(signed, ec.ECDSA(hashes.SHA256())))
    return signature + bytes([flags]) + (7).to_bytes(4, "big")


def token_keys():
    plain = Ed25519PrivateKey.generate()
    raw = string(plain.public_key().public_bytes_raw())
    yield plain, string(b"sk-ssh-ed25519@openssh.com") + raw + string(b"ssh:")
    curve = ec.generate_private_key(ec.SECP256R1())
    point = encode_public_key(curve.public_key()).rpartition(b"nistp256")[2]
    yield curve, string(b"sk-ecdsa-sha2-nistp256@openssh.com") + string(b"nistp256") + point + string(b"ssh:")


@pytest.mark.parametrize(("key", "public"), list(token_keys()), ids=["ed25519", "ecdsa"])
def test_a_security_token_signs_only_when_touched(key, public):
    read = PublicKey.parse(public)
    assert read.is_valid(token_signature(key, public, b"data"), b"data")
    assert not read.is_valid(token_signature(key, public, b"data"), b"other data")
    assert not read.is_valid(token_signature(key, public, b"data", flags=0), b"data")
    assert not read.is_valid(token_signature(key, public, b"data", application=b"web:"), b"data")


def test_short_rsa_keys_and_sha_1_are_refused():
    with pytest.raises(ValueError, match="2048"):
        PublicKey.parse(encode_public_key(rsa.generate_private_key(65537, 1024).public_key()))
    key = rsa.generate_private_key(65537, 2048)
    public = PublicKey.parse(encode_public_key(key.public_key()))
    signature = string(b"ssh-rsa") + string(key.sign(b"data", padding.PKCS1v15(), hashes.SHA1()))
    with pytest.raises(ValueError, match="rsa-sha2-512"):
        public.is_valid(signature, b"data")


@given(st.binary(max_size=300))
def test_any_bytes_are_a_key_or_a_value_error(data):
    for blob in (
        data,
        string(b"ssh-ed25519") + data,
        string(b"ssh-rsa") + data,
        string(b"ecdsa-sha2-nistp256") + data,
    ):
        try:
            found = PublicKey.parse(blob)
        except ValueError:
            continue
        assert isinstance(found, PublicKey)


_KEY = Ed25519PrivateKey.generate()
_CURVE_KEY = ec.generate_private_key(ec.SECP384R1())
_PUBLIC = [PublicKey.parse(encode_public_key(key.public_key())) for key in (_KEY, _CURVE_KEY)]


@given(st.binary(max_size=300), st.sampled_from(_PUBLIC))
def test_any_bytes_are_no_signature(data, public):
    for blob in (data, string(public.key_type) + data, string(public.key_type) + string(data)):
        try:
            assert not public.is_valid(blob, b"data")
        except ValueError:
            continue


@given(st.integers(0, 2**4096))
def test_numbers_are_read_as_written(number):
    reader = Reader(encode_mpint(number))
    assert mpint(reader.string()) == number
    reader.end()


def test_a_signature_must_be_of_the_type_of_its_key():
    good = string(b"ssh-ed25519") + string(_KEY.sign(b"data"))
    assert _PUBLIC[0].is_valid(good, b"data")
    with pytest.raises(ValueError, match="type of the signature"):
        _PUBLIC[0].is_valid(good.replace(b"ssh-ed25519", b"ssh-ed25518"), b"data")
