"""The group `keys`: this bench's key, and the keys of benches and persons that it trusts: arguments and options."""

from __future__ import annotations

from datetime import datetime

import click

from bench.commands.options import JSON

_MOMENT = click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M", "%Y-%m-%dT%H:%M:%S"])
_MOMENT_FORM = "DATE[THH:MM]"
_PASSPHRASE = click.option(
    "--passphrase",
    is_flag=True,
    help="Protect the key by a passphrase, which is asked for at each signature.",
)


@click.group(invoke_without_command=True)
@click.pass_context
def keys(context: click.Context) -> None:
    """Show, create, trust, replace and revoke signing keys. Without a command: show."""
    if context.invoked_subcommand is None:
        context.invoke(keys_show)


@keys.command("show")
def keys_show() -> int:
    """Show this bench's key and the keys that it trusts.

    Also prints the line by which others can trust this bench.
    """
    from bench.commands.keys_output import show_keys

    return show_keys()


@keys.command("list")
@JSON
def keys_list(as_json: bool) -> int:
    """List all trusted keys: what each may sign, its period of validity, and whether it is revoked."""
    from bench.commands.keys_output import list_keys

    return list_keys(as_json=as_json)


@keys.command("create")
@click.option("--principal", help="Name of the signer, as name@place.  [default: bench@ and the host name]")
@_PASSPHRASE
def keys_create(principal: str | None, passphrase: bool) -> int:
    """Create this bench's key."""
    from bench.commands.keys_output import make_key

    return make_key(principal, protect=passphrase)


@keys.command("trust")
@click.argument("key")
@click.option("--person", metavar="NAME@PLACE", help="Trust the key of this person for authorisations only.")
@click.option("--bench", metavar="NAME@PLACE", help="Trust the key of this bench for seals only.")
@click.option("--valid-after", type=_MOMENT, metavar=_MOMENT_FORM, help="Trust it from this time on, UTC.")
@click.option("--valid-before", type=_MOMENT, metavar=_MOMENT_FORM, help="Trust it until this time, UTC.")
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
    from bench.commands.keys_output import trust_key

    return trust_key(key, person=person, bench=bench, valid_after=valid_after, valid_before=valid_before)


@keys.command("rotate")
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
    from bench.commands.keys_output import rotate_key

    return rotate_key(keep_old=old_key == "archive", protect=passphrase)


@keys.command("revoke")
@click.argument("key")
@click.option("--reason", required=True, help="Why: one line, for example 'laptop stolen'.")
@click.option(
    "--since",
    type=_MOMENT,
    metavar=_MOMENT_FORM,
    help="Time from which its signatures are refused, UTC.  [default: now]",
)
def keys_revoke(key: str, reason: str, since: datetime | None) -> int:
    """Revoke a key that was stolen or lost. KEY is its fingerprint, or the file of the public key.

    Its signatures are refused, unless a trusted time stamp proves that they are older. To replace a key that is safe,
    use `starbench keys rotate`.
    """
    from bench.commands.keys_output import revoke_key

    return revoke_key(key, reason=reason, since=since)
