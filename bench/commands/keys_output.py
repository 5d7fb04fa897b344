"""Output of the group `keys`: this bench's key, trusted and revoked keys."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.errors import EvidenceError, UsageError
from bench.base.home import home_folder
from bench.commands.evidence_output import ask_passphrase
from bench.commands.output import print_json

if TYPE_CHECKING:
    from bench.evidence.keys import BenchKey
    from bench.evidence.revocation import RevokedKey
    from bench.evidence.signers import Signer


def show_keys() -> int:
    """Print this bench's key and the keys that it trusts.

    Returns: Exit status, 0.
    """
    from bench.evidence.keys import KEY_FILE
    from bench.evidence.public_key import load_public_key
    from bench.evidence.signers import SIGNERS_FILE, read_signers
    from bench.evidence.ssh_keys import fingerprint

    home = home_folder()
    if not (home / KEY_FILE).exists():
        click.echo(
            "This bench has no key yet; the first run creates one, and so does `starbench keys create`."
        )
    else:
        own = load_public_key(home)
        signers = read_signers(home / SIGNERS_FILE) if (home / SIGNERS_FILE).exists() else []
        line = next((one.line for one in signers if one.public_key == own.public_key), own.line)
        click.echo(
            f"Key:         {home / KEY_FILE}\nFingerprint: {fingerprint(own.public_key)}\n"
            f"Line for the allowed_signers file of those who verify:\n  {line}"
        )
    if (home / SIGNERS_FILE).exists():
        click.echo(f"Trusted here ({home / SIGNERS_FILE}):")
        _print_keys(*_read_lists(home))
    return 0


def list_keys(*, as_json: bool) -> int:
    """Print all trusted keys with their validity.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    from bench.evidence.ssh_keys import fingerprint

    signers, revoked = _read_lists(home_folder())
    if as_json:
        dates = {one.public_key: one for one in revoked}
        print_json(
            {
                "schema": "starbench/keys/1",
                "keys": [
                    {
                        "principal": one.principal,
                        "fingerprint": fingerprint(one.public_key),
                        "purposes": list(one.namespaces),
                        "valid_after": _iso(one.valid_after),
                        "valid_before": _iso(one.valid_before),
                        "revoked": _iso(dates[one.public_key].since) if one.public_key in dates else None,
                        "reason": dates[one.public_key].reason if one.public_key in dates else None,
                    }
                    for one in signers
                ],
            }
        )
    elif signers:
        _print_keys(signers, revoked)
    else:
        click.echo(
            "No key is trusted here yet. `starbench keys create` makes one, `starbench keys trust` adds one."
        )
    return 0


def make_key(principal: str | None, *, protect: bool) -> int:
    """Create this bench's signing key.

    principal: Name of the signer, as name@place; bench@ and the host name where None.
    protect: Whether to ask for a passphrase that protects the key.
    Returns: Exit status, 0.
    """
    from bench.evidence.keys import create_key
    from bench.evidence.signers import make_private_folder

    passphrase = _new_passphrase() if protect else None
    make_private_folder(home_folder())
    key = create_key(home_folder(), principal=principal, passphrase=passphrase)
    click.echo(f"Created {key.fingerprint}. Line for the allowed_signers file of those who verify:")
    click.echo(f"  {key.signers_line}")
    return 0


def trust_key(
    text: str,
    *,
    person: str | None,
    bench: str | None,
    valid_after: datetime | None,
    valid_before: datetime | None,
) -> int:
    """Trust the key of a bench or of a person.

    text: A line of allowed_signers, a public key, or a file that holds one of them.
    person, bench: Name of the person or bench, as name@place, for a public key; at most one of both.
    valid_after, valid_before: Period of validity, UTC without time zone; None where there is no limit.
    Returns: Exit status, 0.
    Raises UsageError: If this is not a key, or a name is missing or not name@place.
    """
    from bench.evidence.signers import (
        AUTHORISATION_NAMESPACE,
        NAMESPACE,
        PRINCIPAL,
        Signer,
        read_signer,
        trust,
    )
    from bench.evidence.ssh_keys import fingerprint

    if person and bench:
        raise UsageError("Give --person or --bench, not both.", remedy="One key never seals and authorises.")
    name = person or bench
    text = _text_of(text)
    try:
        public_key = _public_key(text)
        if public_key is None:
            if name is not None:
                raise UsageError(
                    "--person and --bench need a public key, not a whole line of allowed_signers."
                )
            signer = read_signer(text)
        else:
            if name is None:
                raise UsageError(
                    "A public key needs the name of its owner.",
                    remedy="Add --person NAME@PLACE for a person who authorises, or --bench NAME@PLACE.",
                )
            if not PRINCIPAL.fullmatch(name):
                raise UsageError(
                    f"{name!r} is not of the form NAME@PLACE.",
                    remedy="Write it as an e-mail address, without spaces: anna.berg@lab.example.",
                )
            purpose = AUTHORISATION_NAMESPACE if person else NAMESPACE
            signer = Signer(name, public_key, (purpose,))
        signer = replace(
            signer,
            valid_after=_utc(valid_after) or signer.valid_after,
            valid_before=_utc(valid_before) or signer.valid_before,
        )
        is_as_given = public_key is None and valid_after is None and valid_before is None
        trust(home_folder(), text if is_as_given else signer.line)
    except EvidenceError as error:
        raise UsageError(error.what, where=error.where, remedy=error.remedy) from error
    click.echo(f"Trusted: {signer.principal}  {fingerprint(signer.public_key)}  {_purpose(signer)}")
    return 0


def rotate_key(*, keep_old: bool, protect: bool) -> int:
    """Replace this bench's key.

    keep_old: Whether to keep the old private key; else it is deleted.
    protect: Whether to ask for a passphrase that protects the new key.
    Returns: Exit status, 0.
    """
    from bench.evidence.rotation import rotate

    passphrase = _new_passphrase() if protect else None
    done = rotate(home_folder(), datetime.now(UTC), passphrase=passphrase, keep_old=keep_old)
    old = f"is kept in {done.archived}" if done.archived else "was deleted; a copy elsewhere can still sign"
    click.echo(
        f"Old key: {done.old}. Its validity has ended; what it sealed stays valid. The private key {old}.\n"
        f"New key: {done.new}. Line for the allowed_signers file of those who verify:\n  {done.line}\n"
        "They also need the old key's line as it is now in this bench's allowed_signers."
    )
    return 0


def revoke_key(text: str, *, reason: str, since: datetime | None) -> int:
    """Revoke a key.

    text: Fingerprint of a trusted key, or a public key or its file.
    since: From when, UTC without time zone; now where None.
    Returns: Exit status, 0.
    Raises UsageError: If the fingerprint is not that of a trusted key.
    """
    from bench.evidence.keys import KEY_FILE
    from bench.evidence.revocation import REVOKED_FILE, RevokedKey, revoke
    from bench.evidence.ssh_keys import fingerprint

    home = home_folder()
    signers, _ = _read_lists(home)
    public_key = next((one.public_key for one in signers if fingerprint(one.public_key) == text), None)
    public_key = public_key or _public_key(_text_of(text))
    if public_key is None:
        raise UsageError(
            f"No trusted key has the fingerprint {text}.",
            remedy="See `starbench keys list`, or name the file of the public key.",
        )
    key = RevokedKey(public_key, _utc(since) or datetime.now(UTC), reason.strip())
    revoke(home, key)
    click.echo(
        f"Revoked {fingerprint(public_key)}, {key.text}. Give {home / REVOKED_FILE} to those who verify;"
        " ssh-keygen -Y verify reads it with -r."
    )
    own = home / f"{KEY_FILE}.pub"
    if own.exists() and _public_key(_text_of(str(own))) == public_key:
        click.echo("This is this bench's own key. Replace it now: starbench keys rotate --old-key delete")
    return 0


def key_or_draft() -> BenchKey | None:
    """Return the bench's key for results that may stay a draft; say on standard error why, if there is none.

    Returns: The key; None if there is no key on this computer, or it cannot be used.
    """
    from bench.base.errors import BenchError
    from bench.evidence.keys import load_key, require_usable

    home = home_folder()
    try:
        key = load_key(home, ask_passphrase=ask_passphrase)
        require_usable(home, key, datetime.now(UTC))
    except BenchError as error:
        click.echo(f"DRAFT: the results will not be sealed. {error}", err=True)
        return None
    return key


def _read_lists(home: Path) -> tuple[list[Signer], list[RevokedKey]]:
    from bench.evidence.revocation import REVOKED_FILE, read_revoked
    from bench.evidence.signers import SIGNERS_FILE, read_signers

    signers = read_signers(home / SIGNERS_FILE) if (home / SIGNERS_FILE).exists() else []
    return signers, read_revoked(home / REVOKED_FILE)


def _print_keys(signers: list[Signer], revoked: list[RevokedKey]) -> None:
    from bench.evidence.ssh_keys import fingerprint

    dates = {one.public_key: one for one in revoked}
    for one in signers:
        mark = f"  REVOKED {dates[one.public_key].text}" if one.public_key in dates else ""
        click.echo(f"  {one.principal}  {fingerprint(one.public_key)}  {_purpose(one)}{_validity(one)}{mark}")
    trusted = {one.public_key for one in signers}
    for gone in revoked:
        if gone.public_key not in trusted:
            click.echo(f"  not trusted  {fingerprint(gone.public_key)}  REVOKED {gone.text}")


def _purpose(signer: Signer) -> str:
    from bench.evidence.signers import AUTHORISATION_NAMESPACE, NAMESPACE

    words = {NAMESPACE: "seals", AUTHORISATION_NAMESPACE: "authorises"}
    may = [word for namespace, word in words.items() if signer.may_sign(namespace)]
    return " and ".join(may) or "neither seals nor authorises"


def _validity(signer: Signer) -> str:
    after = f", valid from {signer.valid_after:%Y-%m-%d %H:%M} UTC" if signer.valid_after else ""
    ends = "expired" if signer.valid_before and signer.valid_before < datetime.now(UTC) else "valid until"
    before = f", {ends} {signer.valid_before:%Y-%m-%d %H:%M} UTC" if signer.valid_before else ""
    return f"{after}{before}"


def _new_passphrase() -> bytes | None:
    answer: str = click.prompt("Passphrase", hide_input=True, confirmation_prompt=True, err=True)
    return answer.encode() or None


def _text_of(text: str) -> str:
    """Return the text of a file, or the text itself if there is no such file."""
    from bench.records.storage import storage_errors

    if len(text) > 255 or " " in text or not Path(text).is_file():
        return text
    with storage_errors(Path(text)), Path(text).open("rb") as stream:
        return stream.read(1 << 20).decode(errors="replace").strip()


def _public_key(text: str) -> bytes | None:
    """Return the public key of a text; None if it begins with something else."""
    from bench.evidence.signers import read_public_key

    try:
        return read_public_key(text)
    except ValueError:
        return None


def _utc(moment: datetime | None) -> datetime | None:
    return None if moment is None else moment.replace(tzinfo=UTC)


def _iso(moment: datetime | None) -> str | None:
    return None if moment is None else moment.isoformat()
