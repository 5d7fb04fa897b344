"""Persons with keys of their own, and a time stamping authority by openssl: for tests of what lies beside a seal."""

import base64
import shutil
import subprocess
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest

from bench.evidence.personal_key import load_file_key
from bench.evidence.signers import AUTHORISATION_NAMESPACE, Signer
from bench.evidence.ssh_keys import string

needs_ssh_keygen = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="no ssh-keygen")
needs_openssl = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
needs_certificates = pytest.mark.skipif(
    find_spec("bench.extras") is None, reason="certificates are an extra, which is not here"
)

KEY_KINDS = {
    "ed25519": ("ed25519",),
    "nistp256": ("ecdsa", "-b", "256"),
    "nistp384": ("ecdsa", "-b", "384"),
    "nistp521": ("ecdsa", "-b", "521"),
    "rsa": ("rsa", "-b", "2048"),
}

_CONFIGURATION = """\
[req]
distinguished_name=dn
prompt=no
[dn]
CN=x
[root]
basicConstraints=critical,CA:true
keyUsage=critical,keyCertSign
subjectKeyIdentifier=hash
[stamps]
basicConstraints=critical,CA:false
keyUsage=critical,digitalSignature
extendedKeyUsage=critical,timeStamping
subjectKeyIdentifier=hash
authorityKeyIdentifier=keyid
[tsa]
default_tsa=one
[one]
serial=serial
signer_digest=sha256
default_policy=1.2.3.4.1
digests=sha256,sha512
accuracy=secs:1
ess_cert_id_alg=sha256
"""


def make_key(folder, name="ada", kind="ed25519", passphrase=""):
    """Make a key pair with ssh-keygen; returns the path of the private key."""
    path = Path(folder) / name
    command = ["ssh-keygen", "-q", "-t", *KEY_KINDS[kind], "-N", passphrase, "-C", name, "-f", path]
    subprocess.run(command, check=True, capture_output=True)
    return path


def person(path, name="ada@lab.example", passphrase=b""):
    """Load a key for signing, and the line that trusts it for authorisations."""
    key = load_file_key(path, lambda _: passphrase)
    return key, Signer(name, key.public_key, (AUTHORISATION_NAMESPACE,))


def armoured(public, signature, namespace="a@v1"):
    """An SSH signature of these parts, whether it holds or not."""
    parts = (public, namespace.encode(), b"", b"sha512", signature)
    blob = base64.encodebytes(b"SSHSIG\0\0\0\1" + b"".join(map(string, parts)))
    return b"-----BEGIN SSH SIGNATURE-----\n" + blob + b"-----END SSH SIGNATURE-----\n"


@dataclass(frozen=True)
class Authority:
    """A time stamping authority in a folder: ``root.pem`` is its root certificate."""

    folder: Path

    @property
    def root(self):
        return self.folder / "root.pem"

    @classmethod
    def create(cls, folder, name="Example TSA"):
        folder.mkdir()
        (folder / "c.cnf").write_text(_CONFIGURATION)
        (folder / "serial").write_text("01\n")
        made = cls(folder)
        curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-config", "c.cnf")
        made.run(
            "req", "-x509", *curve, "-keyout", "root.key", "-out", "root.pem", "-days", "3650",
            "-subj", f"/O=Example/CN={name} root", "-extensions", "root",
        )  # fmt: skip
        made.run("req", *curve, "-keyout", "tsa.key", "-out", "tsa.csr", "-subj", f"/O=Example/CN={name}")
        made.run(
            "x509", "-req", "-in", "tsa.csr", "-CA", "root.pem", "-CAkey", "root.key", "-CAcreateserial",
            "-out", "tsa.pem", "-days", "3650", "-extfile", "c.cnf", "-extensions", "stamps",
        )  # fmt: skip
        return made

    def run(self, *arguments):
        subprocess.run(["openssl", *arguments], cwd=self.folder, check=True, capture_output=True)

    def reply(self, request, *more):
        """Answer a request in DER."""
        (self.folder / "q.tsq").write_bytes(request)
        self.run(
            "ts", "-reply", "-config", "c.cnf", "-queryfile", "q.tsq", "-signer", "tsa.pem", "-inkey", "tsa.key",
            "-out", "r.tsr", *more,
        )  # fmt: skip
        return (self.folder / "r.tsr").read_bytes()

    def accepts(self, folder, name, of):
        """Whether stock openssl verifies a time stamp."""
        command = ["openssl", "ts", "-verify", "-in", name, "-data", of, "-CAfile", self.root]
        done = subprocess.run(command, cwd=folder, capture_output=True, check=False)
        return done.returncode == 0 and b"Verification: OK" in done.stdout + done.stderr
