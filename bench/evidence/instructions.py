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

_TEXT = """\
This folder is {what}, sealed by the bench that made it.
To check it you need OpenSSH (8.1 or newer) and sha256sum, nothing else. In this folder:

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

With Starbench at hand, `starbench verify` makes these checks and more. The folder is read-only; to
delete it: chmod -R u+w, then rm -r.
"""


def kind_of(path: Path) -> str:
    """Return what a folder is, by its content.

    Parameters
    ----------
    path
        The folder.

    Returns
    -------
    str
        ``run``, ``certificate``, ``results`` (recalculated) or ``files``.
    """
    return next((kind for name, kind in KINDS.items() if (path / name).is_file()), "files")


def instructions(kind: str, *, principal: str, fingerprint: str) -> str:
    """Return the text of ``VERIFY.txt``.

    Parameters
    ----------
    kind
        What the folder is, from `kind_of`.
    principal
        Name of the bench that seals, as ``name@place``.
    fingerprint
        Fingerprint of the bench's key.

    Returns
    -------
    str
        The text.
    """
    return _TEXT.format(what=_WHAT[kind], principal=principal, fingerprint=fingerprint)
