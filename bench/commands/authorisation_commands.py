"""Commands of the group `certificate` that add to a sealed folder: authorise, timestamp. Arguments and options only."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import JSON, ExistingFile, ExistingFolder, NewFile

_FOLDER = click.argument("folder", metavar="FOLDER", type=ExistingFolder())
_SIGNERS = click.option(
    "--allowed-signers", type=ExistingFile(), help="File of trusted keys.  [default: this bench's own]"
)
_TSA_CERTIFICATES = click.option(
    "--tsa-certificates",
    type=ExistingFile(),
    help="Root certificates of trusted time stamping authorities, PEM.  [default: this bench's own]",
)


@click.command("authorise")
@_FOLDER
@click.option(
    "--key",
    metavar="FILE|SHA256:...",
    help="Your private key; or, for a key in ssh-agent, its public key or fingerprint.  [default: the key that the"
    " certificate names, else the only one in ssh-agent]",
)
@_SIGNERS
@click.option("--yes", is_flag=True, help="Do not ask; for scripts.")
@JSON
def authorise(folder: Path, key: str | None, allowed_signers: Path | None, yes: bool, as_json: bool) -> int:
    """Authorise a sealed FOLDER (certificate, run or results) with your own key.

    The folder is verified and shown, and you confirm. Your signature of its seal is added; nothing else changes. A
    passphrase is asked for, or taken from the variable STARBENCH_PASSPHRASE.
    """
    from bench.commands.authorisation_output import authorise_folder

    return authorise_folder(folder, key, allowed_signers=allowed_signers, yes=yes, as_json=as_json)


@click.command("timestamp")
@_FOLDER
@click.option("--tsa", metavar="URL", help="Ask this time stamping authority over the network.")
@click.option("--token", type=ExistingFile(), help="Add this reply or token of an authority.")
@click.option("--request", "request_file", type=NewFile(), help="Write a request to this file; add nothing.")
@click.option(
    "--of",
    "what",
    type=click.Choice(["seal", "authorisation"]),
    help="Which signature to stamp.  [default: the authorisation if there is one, else the seal]",
)
@_TSA_CERTIFICATES
@JSON
def timestamp(
    folder: Path,
    tsa: str | None,
    token: Path | None,
    request_file: Path | None,
    what: str | None,
    tsa_certificates: Path | None,
    as_json: bool,
) -> int:
    """Add a time stamp (RFC 3161) to a sealed or authorised FOLDER.

    Without a network: write a request with --request, take it to an authority, and add its reply with --token. A time
    stamp of the authorisation proves the time of the seal too.
    """
    from bench.commands.timestamp_output import stamp_folder, write_request

    if sum(option is not None for option in (tsa, token, request_file)) != 1:
        raise click.UsageError("Give one of --tsa, --token and --request.")
    if request_file is not None:
        return write_request(folder, what, request_file, as_json=as_json)
    return stamp_folder(
        folder, what, tsa=tsa, token=token, tsa_certificates=tsa_certificates, as_json=as_json
    )


AUTHORISATION_COMMANDS = (authorise, timestamp)
"""Commands of this module, for the group `certificate`."""
