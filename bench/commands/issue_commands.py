"""Commands of the group `certificate` that make and list certificates. Arguments, options and exit statuses only."""

from __future__ import annotations

from pathlib import Path

import click

from bench.base.errors import UsageError
from bench.commands.options import JSON, ExistingFile, ExistingFolder, NewFile, OutputFolder

_CONFIG = click.option(
    "--config",
    "-c",
    "lab_file",
    required=True,
    type=ExistingFile(),
    metavar="LAB.YAML",
    help="What the run cannot know: laboratory, customer, item and more. `starbench certificate new` writes an"
    " example.",
)
_OUTPUT = click.option(
    "--output", "-o", required=True, type=OutputFolder(), help="New folder for the certificate."
)


_XADES_KEY = click.option(
    "--xades-key",
    type=ExistingFile(),
    metavar="PEM",
    help="Key of the laboratory that signs the digital certificate (XAdES).",
)
_XADES_CERTIFICATE = click.option(
    "--xades-certificate",
    type=ExistingFile(),
    metavar="PEM",
    help="Certificate of that key, followed by the certificates that lead to one that your customers trust.",
)


@click.command("new")
@click.option("--output", "-o", required=True, type=NewFile(), help="New file, such as lab.yaml.")
def new(output: Path) -> int:
    """Write an example of lab.yaml, with comments. Replace every REPLACE in it."""
    from bench.commands.issue_output import write_example

    return write_example(output)


@click.command("issue")
@click.argument("run_folder", metavar="RUN", type=ExistingFolder())
@_CONFIG
@_OUTPUT
@click.option(
    "--also",
    metavar="REASON",
    default="",
    help="Issue a further certificate of the same run; why it is needed.",
)
@_XADES_KEY
@_XADES_CERTIFICATE
@JSON
def issue(
    run_folder: Path,
    lab_file: Path,
    output: Path,
    also: str,
    xades_key: Path | None,
    xades_certificate: Path | None,
    as_json: bool,
) -> int:
    """Issue the calibration certificate of a sealed RUN, by ISO/IEC 17025.

    The run is verified first. If neither the run nor LAB.YAML answers a clause of the standard, no certificate is
    issued; the command names the clause and the missing key of LAB.YAML. A new certificate is SEALED. A person then
    authorises it with `starbench certificate authorise`.
    """
    from bench.commands.issue_output import issue_certificate

    return issue_certificate(
        run_folder,
        lab_file,
        output,
        also=also,
        dcc_key=_dcc_key(xades_key, xades_certificate),
        as_json=as_json,
    )


@click.command("amend")
@click.argument("folder", metavar="FOLDER", type=ExistingFolder())
@_CONFIG
@click.option("--reason", required=True, help="Reason of the amendment; it is printed.")
@_OUTPUT
@_XADES_KEY
@_XADES_CERTIFICATE
@JSON
def amend(
    folder: Path,
    lab_file: Path,
    reason: str,
    output: Path,
    xades_key: Path | None,
    xades_certificate: Path | None,
    as_json: bool,
) -> int:
    """Replace the certificate in FOLDER by a new one with a new number.

    The new certificate names the old one by number and hash, and lists every field that changed. The old one stays as
    it is; `starbench verify` says that it is superseded.
    """
    from bench.commands.issue_output import amend_certificate

    return amend_certificate(
        folder,
        lab_file,
        output,
        reason=reason,
        dcc_key=_dcc_key(xades_key, xades_certificate),
        as_json=as_json,
    )


def _dcc_key(key: Path | None, certificate: Path | None) -> tuple[Path, Path] | None:
    """Return both files of the signature in the DCC, or none."""
    if key is None and certificate is None:
        return None
    if key is None or certificate is None:
        raise UsageError(
            "The signature in the digital certificate needs a key and its certificate.",
            remedy="Give both --xades-key and --xades-certificate, or neither.",
        )
    return key, certificate


@click.command("void")
@click.argument("number")
@click.option("--reason", required=True, help="Why the number is not used; it is kept in the ledger.")
@click.option("--by", metavar="NAME", help="Your name.  [default: user@host]")
@JSON
def void(number: str, reason: str, by: str | None, as_json: bool) -> int:
    """Declare the NUMBER of a certificate void.

    The number was reserved by a command that was stopped or failed, so no certificate has it.
    """
    from bench.commands.issue_output import void_number

    return void_number(number, reason=reason, by=by, as_json=as_json)


@click.command("list")
@JSON
def list_(as_json: bool) -> int:
    """List all certificates of this bench.

    The ledger gives the state of each number, the camera, the customer and the date.
    """
    from bench.commands.issue_output import list_certificates

    return list_certificates(as_json=as_json)


@click.command("show")
@click.argument("folder", metavar="FOLDER", type=ExistingFolder())
@JSON
def show(folder: Path, as_json: bool) -> int:
    """Show the certificate in FOLDER: its state, item, results and statements of conformity."""
    from bench.commands.issue_output import show_certificate

    return show_certificate(folder, as_json=as_json)


ISSUE_COMMANDS = (new, issue, amend, void, list_, show)
"""Commands of this module, for the group `certificate`."""
