"""The group `keys`: this bench's key, and the keys of benches and persons that it trusts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from bench.base.errors import BenchError, EvidenceError, UsageError
from bench.base.home import home_folder
from bench.commands.options import MOMENT, MOMENT_FORM, Family, epilog
from bench.commands.output import JSON, ask_passphrase, show
from bench.evidence.key_rotation import rotate
from bench.evidence.keys import BenchKey, create_key, load_key, require_usable
from bench.evidence.public_half import KEY_FILE, load_public_key
from bench.evidence.revoked_keys import REVOKED_FILE, RevokedKey, read_revoked, revoke
from bench.evidence.signers import (
    AUTHORISATION_NAMESPACE,
    NAMESPACE,
    PRINCIPAL,
    SIGNERS_FILE,
    Signer,
    make_private_folder,
    read_public_key,
    read_signer,
    signers_of,
    trust,
)
from bench.evidence.ssh_keys import fingerprint
from bench.record.storage import storage_errors

_PASSPHRASE = click.option(
    "--passphrase",
    is_flag=True,
    help="Protect the key by a passphrase, which is asked for at each signature.",
)


@click.group(cls=Family, invoke_without_command=True, epilog=epilog("starbench keys show"))
@click.pass_context
def keys(context: click.Context) -> None:
    """Show, create, trust, replace and revoke signing keys. Without a command: show."""
    if context.invoked_subcommand is None:
        context.invoke(keys_show)


@keys.command("show", epilog=epilog("starbench keys show"))
@JSON
def keys_show() -> int:
    """Show this bench's key and the keys that it trusts: what each may sign, its validity, and whether it is revoked.

    Also prints the line by which others can trust this bench.
    """
    signers, revoked = _read_lists(home_folder())
    show(lambda: _keys_dict(signers, revoked), _keys_lines(signers, revoked))
    return 0


def _keys_dict(signers: Sequence[Signer], revoked: Sequence[RevokedKey]) -> dict[str, Any]:
    gone = {revoked_key.public_key: revoked_key for revoked_key in revoked}
    rows = [
        {
            "principal": signer.principal,
            "fingerprint": fingerprint(signer.public_key),
            "purposes": list(signer.namespaces),
            "valid_after": _iso(signer.valid_after),
            "valid_before": _iso(signer.valid_before),
            "revoked": _iso(gone[signer.public_key].since) if signer.public_key in gone else None,
            "reason": gone[signer.public_key].reason if signer.public_key in gone else None,
        }
        for signer in signers
    ]
    return {"schema": "starbench/keys/1", "keys": rows}


def _keys_lines(signers: Sequence[Signer], revoked: Sequence[RevokedKey]) -> Iterator[str]:
    home = home_folder()
    if not (home / KEY_FILE).exists():
        yield "This bench has no key yet; the first run creates one, and so does `starbench keys create`."
    else:
        own = load_public_key(home)
        line = next((signer.line for signer in signers if signer.public_key == own.public_key), own.line)
        yield from (f"Key:         {home / KEY_FILE}", f"Fingerprint: {fingerprint(own.public_key)}")
        yield from ("Line for the allowed_signers file of those who verify:", f"  {line}")
    if (home / SIGNERS_FILE).exists():
        yield f"Trusted here ({home / SIGNERS_FILE}):"
        yield from _list_lines(signers, revoked)


def _list_lines(signers: Sequence[Signer], revoked: Sequence[RevokedKey]) -> Iterator[str]:
    dates = {revoked_key.public_key: revoked_key for revoked_key in revoked}
    for signer in signers:
        mark = f"  REVOKED {dates[signer.public_key].text}" if signer.public_key in dates else ""
        yield f"  {signer.principal}  {fingerprint(signer.public_key)}  {_purpose(signer)}{_validity(signer)}{mark}"
    trusted = {signer.public_key for signer in signers}
    for gone in revoked:
        if gone.public_key not in trusted:
            yield f"  not trusted  {fingerprint(gone.public_key)}  REVOKED {gone.text}"


@keys.command("create", epilog=epilog("starbench keys create --principal bench2@lab.example"))
@click.option("--principal", help="Name of the signer, as name@place.  [default: bench@ and the host name]")
@_PASSPHRASE
def keys_create(principal: str | None, passphrase: bool) -> int:
    """Create this bench's key."""
    secret = _new_passphrase() if passphrase else None
    make_private_folder(home_folder())
    key = create_key(home_folder(), principal=principal, passphrase=secret)
    click.echo(f"Created {key.fingerprint}. Line for the allowed_signers file of those who verify:")
    click.echo(f"  {key.signers_line}")
    click.echo(
        f"Keep copies of {home_folder()}, and in another place the newest head of its ledger, which each report and\n"
        "message prints: it shows whether a restored copy is too old."
    )
    return 0


@keys.command(
    "trust",
    epilog=epilog(
        "starbench keys trust 'bench2@lab.example namespaces=\"starbench-report@v1\" ssh-ed25519 AAAA...'",
        "starbench keys trust id_ed25519.pub --person ada@lab.example --valid-before 2028-01-01",
    ),
)
@click.argument("key")
@click.option("--person", metavar="NAME@PLACE", help="Trust the key of this person for authorisations only.")
@click.option("--bench", metavar="NAME@PLACE", help="Trust the key of this bench for seals only.")
@click.option("--valid-after", type=MOMENT, metavar=MOMENT_FORM, help="Trust it from this time on, UTC.")
@click.option("--valid-before", type=MOMENT, metavar=MOMENT_FORM, help="Trust it until this time, UTC.")
def keys_trust(
    key: str,
    person: str | None,
    bench: str | None,
    valid_after: datetime | None,
    valid_before: datetime | None,
) -> int:
    """Trust the key of another bench, or of a person who authorises.

    KEY is what `starbench keys show` prints on the other bench; or a public key, or its file, with --person or --bench.
    """
    if person and bench:
        raise UsageError("Give --person or --bench, not both.", remedy="One key never seals and authorises.")
    text = _text_of(key)
    is_whole_line = _public_key(text) is None
    try:
        signer = _signer(text, person, bench)
        signer = replace(
            signer,
            valid_after=_utc(valid_after) or signer.valid_after,
            valid_before=_utc(valid_before) or signer.valid_before,
        )
        is_as_given = is_whole_line and valid_after is None and valid_before is None
        trust(home_folder(), text if is_as_given else signer.line)
    except EvidenceError as error:
        raise UsageError(error.what, where=error.where, remedy=error.remedy) from error
    click.echo(f"Trusted: {signer.principal}  {fingerprint(signer.public_key)}  {_purpose(signer)}")
    return 0


def _signer(text: str, person: str | None, bench: str | None) -> Signer:
    """Return the signer that a whole line describes, or a public key and the name of its owner."""
    public_key, name = _public_key(text), person or bench
    if public_key is None:
        if name is not None:
            raise UsageError(
                "This is no public key, which --person and --bench need.",
                remedy="Name a file that ends in .pub. For a whole line of allowed_signers, leave both out.",
            )
        return read_signer(text)
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
    return Signer(name, public_key, (AUTHORISATION_NAMESPACE if person else NAMESPACE,))


@keys.command("rotate", epilog=epilog("starbench keys rotate --old-key delete"))
@click.option(
    "--old-key",
    type=click.Choice(["archive", "delete"]),
    default="archive",
    show_default=True,
    help="What to do with the old private key.",
)
@_PASSPHRASE
def keys_rotate(old_key: str, passphrase: bool) -> int:
    """Replace this bench's key by a new one.

    The old key's validity ends now, so that what it has sealed stays valid and nothing new does. Give the new line to
    those who verify.
    """
    secret = _new_passphrase() if passphrase else None
    done = rotate(home_folder(), datetime.now(UTC), passphrase=secret, keep_old=old_key == "archive")
    old = f"is kept in {done.archived}" if done.archived else "was deleted; a copy elsewhere can still sign"
    click.echo(
        f"Old key: {done.old}. Its validity has ended; what it sealed stays valid. The private key {old}.\n"
        f"New key: {done.new}. Line for the allowed_signers file of those who verify:\n  {done.line}\n"
        "They also need the old key's line as it is now in this bench's allowed_signers."
    )
    return 0


@keys.command("revoke", epilog=epilog("starbench keys revoke SHA256:... --reason 'laptop stolen'"))
@click.argument("key")
@click.option("--reason", required=True, help="Why: one line, for example 'laptop stolen'.")
@click.option(
    "--since",
    type=MOMENT,
    metavar=MOMENT_FORM,
    help="Time from which its signatures are refused, UTC.  [default: now]",
)
def keys_revoke(key: str, reason: str, since: datetime | None) -> int:
    """Revoke a key that was stolen or lost. KEY is its fingerprint, or the file of the public key.

    Its signatures are refused, unless a trusted time stamp proves that they are older. To replace a key that is safe,
    use `starbench keys rotate`.
    """
    home = home_folder()
    signers, _ = _read_lists(home)
    public_key = next(
        (signer.public_key for signer in signers if fingerprint(signer.public_key) == key), None
    )
    public_key = public_key or _public_key(_text_of(key))
    if public_key is None:
        raise UsageError(
            f"No trusted key has the fingerprint {key}.",
            remedy="See `starbench keys show`, or name the file of the public key.",
        )
    revoked = RevokedKey(public_key, _utc(since) or datetime.now(UTC), reason.strip())
    revoke(home, revoked)
    click.echo(
        f"Revoked {fingerprint(public_key)}, {revoked.text}. Give {home / REVOKED_FILE} to those who verify;"
        " ssh-keygen -Y verify reads it with -r."
    )
    own = home / f"{KEY_FILE}.pub"
    if own.exists() and _public_key(_text_of(str(own))) == public_key:
        click.echo("This is this bench's own key. Replace it now: starbench keys rotate --old-key delete")
    return 0


def key_or_draft() -> BenchKey | None:
    """Return the bench's key, or say on standard error why there is none that can be used: results stay a draft."""
    home = home_folder()
    try:
        key = load_key(home, ask_passphrase=ask_passphrase)
        require_usable(home, key, datetime.now(UTC))
    except BenchError as error:
        click.echo(f"DRAFT: the results will not be sealed. {error}", err=True)
        return None
    return key


def _read_lists(home: Path) -> tuple[list[Signer], list[RevokedKey]]:
    signers = signers_of(home)
    return signers, read_revoked(home / REVOKED_FILE)


def _purpose(signer: Signer) -> str:
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
    if len(text) > 255 or " " in text or not Path(text).is_file():
        return text
    with storage_errors(Path(text)), Path(text).open("rb") as stream:
        return stream.read(1 << 20).decode(errors="replace").strip()


def _public_key(text: str) -> bytes | None:
    """Return the public key of a text; None if it begins with something else."""
    try:
        return read_public_key(text)
    except ValueError:
        return None


def _utc(moment: datetime | None) -> datetime | None:
    return None if moment is None else moment.replace(tzinfo=UTC)


def _iso(moment: datetime | None) -> str | None:
    return None if moment is None else moment.isoformat()
