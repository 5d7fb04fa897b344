"""``VERIFY.txt``: how to check a sealed folder with the stock programs ssh-keygen, sha256sum and openssl.

The kinds of folder differ in the first sentence and in what the certificate names. Text only; nothing is checked here.
"""

from __future__ import annotations

from pathlib import Path

from bench.records.run_folder import JOURNAL

KINDS = {JOURNAL: "run", "certificate.json": "certificate", "sources.json": "results"}
"""Kind of a sealed folder by the file that only this kind has."""

_WHAT = {
    "run": "the record of one run of Starbench",
    "certificate": "a calibration certificate made by Starbench",
    "results": "a calibration that Starbench calculated from existing files (a recalculation)",
    "files": "a set of files made by Starbench",
}

_MORE = {
    "run": "",
    "certificate": """
certificate.json names the person who is to authorise it (authorised_by), with the fingerprint of the
person's key. ssh-keygen must print the same fingerprint.
""",
    "results": """
sources.json names the files that these results were calculated from, with their SHA-256. To check one:
sha256sum FILE.
""",
    "files": "",
}

_TEXT = """\
This folder is {what}, sealed by the bench that made it.
To check it you need OpenSSH (8.9 or newer), sha256sum, and for time stamps openssl, nothing else.
Run the commands in this folder.

1. THE SEAL: which bench made these files, and that none was changed

    ssh-keygen -Y verify -f allowed_signers -I {principal} -n starbench-report@v1 -s SHA256SUMS.sig < SHA256SUMS
    sha256sum --strict --quiet -c SHA256SUMS

Both must end with status 0. They do not find added files or links. A third check finds them; it must
print "complete":

    test -z "$(find . -type l)" && \\
        test "$(find . ! -type d ! -path ./SHA256SUMS ! -path ./SHA256SUMS.sig \\
            ! -path ./SHA256SUMS.authorised.sig ! -path ./SHA256SUMS.tsr \\
            ! -path ./SHA256SUMS.authorised.tsr | wc -l)" -eq "$(wc -l < SHA256SUMS)" && echo complete

allowed_signers is the list of keys that you trust. It is not part of this folder, because a person who
can change the folder could change the list too. Get the list from the laboratory in another way. The
key that signed here has the fingerprint

    {fingerprint}

2. THE AUTHORISATION: which person approved it

Without a file SHA256SUMS.authorised.sig, no person has authorised this folder. Otherwise find the name
of the person, and verify with it in the place of PERSON:

    ssh-keygen -Y find-principals -f allowed_signers -s SHA256SUMS.authorised.sig
    ssh-keygen -Y verify -f allowed_signers -I PERSON -n starbench-authorisation@v1 \\
        -s SHA256SUMS.authorised.sig < SHA256SUMS.sig
{more}
3. THE TIME: that it is not younger than a time stamp says

Without a file SHA256SUMS.tsr or SHA256SUMS.authorised.tsr, only the bench's own clock states a time.
tsa_certificates.pem holds the root certificates of time stamping authorities that you trust:

    openssl ts -verify -in SHA256SUMS.tsr -data SHA256SUMS.sig -CAfile tsa_certificates.pem
    openssl ts -reply -in SHA256SUMS.tsr -text

    openssl ts -verify -in SHA256SUMS.authorised.tsr -data SHA256SUMS.authorised.sig -CAfile tsa_certificates.pem
    openssl ts -reply -in SHA256SUMS.authorised.tsr -text

4. KEYS that have expired or were revoked

ssh-keygen judges a key for today. To judge it for the time of a time stamp, add to its commands:
-O verify-time=YYYYMMDDHHMMSSZ. To refuse revoked keys, add: -r revoked_keys (a list from the laboratory).

With Starbench at hand, `starbench verify` makes these checks and more. The folder is read-only; to
delete it: chmod -R u+w, then rm -r.
"""


def kind_of(path: Path) -> str:
    """Return what a folder is, by its content.

    Returns: ``run``, ``certificate``, ``results`` (recalculated) or ``files``.
    """
    return next((kind for name, kind in KINDS.items() if (path / name).is_file()), "files")


def instructions(kind: str, *, principal: str, fingerprint: str) -> str:
    """Return the text of ``VERIFY.txt``.

    kind: What the folder is, from `kind_of`.
    principal: Name of the bench that seals, as ``name@place``.
    fingerprint: Fingerprint of the bench's key.
    """
    return _TEXT.format(what=_WHAT[kind], more=_MORE[kind], principal=principal, fingerprint=fingerprint)
