"""What a verification found, and a folder sealed again by whoever holds a key."""

from bench.evidence.keys import NAMESPACE
from bench.evidence.seal import make_manifest
from bench.evidence.sshsig import sign


def kinds(verification):
    return sorted((f.kind, f.where) for f in verification.faults)


def reseal(folder, key, namespace=NAMESPACE):
    (folder / "SHA256SUMS").write_bytes(manifest := make_manifest(folder))
    (folder / "SHA256SUMS.sig").write_bytes(sign(key.private, manifest, namespace))
