"""`certificate timestamp`: write a request for a time stamp, or add a reply beside the seal."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.errors import EvidenceError
from bench.base.home import home_folder
from bench.commands.options import ExistingFile, ExistingFolder, NewFile, epilog
from bench.commands.output import JSON, show
from bench.evidence.seal import AUTHORISATION, AUTHORISATION_TIMESTAMP, TIMESTAMP
from bench.evidence.timestamp import LABORATORY_TSA_FILE, STAMPED, TSA_FILE
from bench.records.run_folder import MANIFEST, SIGNATURE
from bench.records.storage import storage_errors

if TYPE_CHECKING:
    from bench.evidence.timestamp import Stamp, TrustedAuthorities

_NAMES = {"seal": TIMESTAMP, "authorisation": AUTHORISATION_TIMESTAMP}


@click.command(
    "timestamp",
    epilog=epilog(
        "starbench certificate timestamp certificates/2026-0042 --tsa https://tsa.example/tsr",
        "starbench certificate timestamp certificates/2026-0042 --request request.tsq",
        "starbench certificate timestamp certificates/2026-0042 --token reply.tsr",
    ),
)
@click.argument("folder", metavar="FOLDER", type=ExistingFolder())
@click.option("--tsa", metavar="URL", help="Ask this time stamping authority over the network.")
@click.option("--token", type=ExistingFile(), help="Add this reply or token of an authority.")
@click.option("--request", "request_file", type=NewFile(), help="Write a request to this file; add nothing.")
@click.option(
    "--of",
    "what",
    type=click.Choice(["seal", "authorisation"]),
    help="Which signature to stamp.  [default: the authorisation if there is one, else the seal]",
)
@click.option(
    "--tsa-certificates",
    type=ExistingFile(),
    help="Root certificates of trusted time stamping authorities, PEM.  [default: this bench's own]",
)
@JSON
def timestamp(
    folder: Path,
    tsa: str | None,
    token: Path | None,
    request_file: Path | None,
    what: str | None,
    tsa_certificates: Path | None,
) -> int:
    """Add a time stamp (RFC 3161) to a sealed or authorised FOLDER.

    Without a network: write a request with --request, take it to an authority, and add its reply with --token. A time
    stamp of the authorisation proves the time of the seal too.
    """
    if sum(option is not None for option in (tsa, token, request_file)) != 1:
        raise click.UsageError("Give one of --tsa, --token and --request.")
    if request_file is not None:
        return _write_request(folder, what, request_file)
    return _stamp_folder(folder, what, tsa, token, tsa_certificates)


def _write_request(folder: Path, what: str | None, path: Path) -> int:
    """Write a request for a time stamp, for a laboratory without a network.

    what: ``seal`` or ``authorisation``; None for the authorisation if there is one.
    """
    from bench.evidence.tsa_client import make_request
    from bench.records.storage import write_atomic

    name = _free_names(folder, what)[0]
    write_atomic(path, make_request(_signed(folder, name), nonce=False).data)
    show(
        {"schema": "starbench/request/1", "request": str(path), "of": STAMPED[name]},
        f"Request for a time stamp of {STAMPED[name]}: {path}\nSend it to an authority, for example with:\n"
        f"  curl -H 'Content-Type: application/timestamp-query' --data-binary @{path} -o reply.tsr URL\n"
        f"Then: starbench certificate timestamp {folder} --token reply.tsr",
    )
    return 0


def _stamp_folder(
    folder: Path, what: str | None, tsa: str | None, token: Path | None, tsa_certificates: Path | None
) -> int:
    """Add a time stamp beside the seal, after checking it.

    what: ``seal`` or ``authorisation``; None for the authorisation if there is one, or for what the token is
      of.
    tsa: Address of the authority to ask; None if there is a token.
    tsa_certificates: Root certificates of trusted authorities; this bench's own where None.
    Raises EvidenceError: If the folder is not sealed or has the time stamp already, or if the time stamp is
      not a valid one of this signature by a trusted authority; nothing is written.
    """
    from bench.evidence.beside_seal import add_beside
    from bench.evidence.timestamp import UncheckedError, as_reply, read_authorities
    from bench.evidence.tsa_client import ask_authority, check_url, make_request

    if tsa is not None:
        check_url(tsa)
    authorities = read_authorities(home_folder(), tsa_certificates)
    names = _free_names(folder, what)
    try:
        if token is not None:
            with storage_errors(token), token.open("rb") as stream:
                reply = as_reply(stream.read(1 << 20))
        else:
            names = names[:1]
            reply = ask_authority(str(tsa), make_request(_signed(folder, names[0]), nonce=True))
        stamp = _check_one(reply, folder, names, authorities)
    except UncheckedError as error:
        raise EvidenceError(
            f"The time stamp cannot be checked, so it is not added: {error.what}.",
            where=str(token or tsa),
            remedy=error.remedy
            or f"Put the authority's root certificate into {home_folder() / TSA_FILE} (or {LABORATORY_TSA_FILE} for the"
            " laboratory's own), or name its file with --tsa-certificates.",
        ) from error
    except EvidenceError as error:
        raise EvidenceError(
            f"This time stamp is not added: {error.what.rstrip('.')}.",
            where=error.where or str(token or tsa),
            remedy=error.remedy or f"It must be a time stamp of {STAMPED[names[0]]} of this folder.",
        ) from error
    add_beside(folder, stamp.file, reply)
    show(
        {
            "schema": "starbench/timestamp/1",
            "file": stamp.file,
            "of": stamp.of,
            "utc": stamp.utc.isoformat(),
            "authority": stamp.authority,
            "laboratory_clock": stamp.is_laboratory,
        },
        f"{stamp.file}: {stamp.of} existed at {stamp.text}.",
    )
    return 0


def _check_one(reply: bytes, folder: Path, names: Sequence[str], authorities: TrustedAuthorities) -> Stamp:
    """Check a reply for the first of these names; for the next one only if it is a time stamp of another file."""
    from bench.evidence.timestamp import OtherFileError, check_reply

    for name in names[:-1]:
        with suppress(OtherFileError):
            return check_reply(reply, _signed(folder, name), authorities, name)
    return check_reply(reply, _signed(folder, names[-1]), authorities, names[-1])


def _free_names(folder: Path, what: str | None) -> list[str]:
    """Return the files of time stamps that can be made; refuses what is not there to stamp, or is stamped already."""
    if not (folder / MANIFEST).is_file() or not (folder / SIGNATURE).is_file():
        raise EvidenceError(
            "This folder is not sealed, so there is nothing to stamp.",
            where=str(folder),
            remedy="Finish the run, or issue the certificate, which seals it.",
        )
    is_authorised = (folder / AUTHORISATION).is_file()
    if what == "authorisation" and not is_authorised:
        raise EvidenceError(
            "This folder is not authorised.",
            where=str(folder),
            remedy="Use `starbench certificate authorise`.",
        )
    names = [_NAMES[what]] if what else [*([AUTHORISATION_TIMESTAMP] if is_authorised else []), TIMESTAMP]
    free = [name for name in names if not (folder / name).exists()]
    if not free:
        raise EvidenceError(
            f"There is a time stamp already ({' and '.join(names)}); it is never replaced.",
            where=str(folder),
            remedy="Check it with `starbench verify`.",
        )
    return free


def _signed(folder: Path, name: str) -> bytes:
    """Return the signature to stamp; refuses one that does not hold, because its time would be worthless."""
    from bench.evidence.sshsig import is_valid, read_signature

    of = STAMPED[name]
    with storage_errors(folder):
        data = (folder / of).read_bytes()
        signed = (folder / (MANIFEST if of == SIGNATURE else SIGNATURE)).read_bytes()
    if not is_valid(read_signature(data), signed):
        raise EvidenceError(
            f"{of} is not a valid signature, so it is not stamped.",
            where=str(folder),
            remedy="See all faults with `starbench verify`.",
        )
    return data
