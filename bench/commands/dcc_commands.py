"""Commands of the group `certificate` for DCCs: check, from-dcc. Arguments, options and exit statuses only."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import JSON, ExistingFile, ExistingPath


@click.command()
@click.argument("path", metavar="FILE", type=ExistingPath())
@click.option(
    "--schemas",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder with PTB's schemas dcc.xsd and SI_Format.xsd.  [default: $STARBENCH_DCC_SCHEMAS]",
)
@click.option(
    "--trusted",
    type=ExistingFile(),
    metavar="PEM",
    help="Certificates that you trust; the signature must lead to one of them.",
)
@JSON
def check(path: Path, schemas: Path | None, trusted: Path | None, as_json: bool) -> int:
    """Check a digital calibration certificate: an XML FILE, or the folder of a certificate.

    Its content is checked for completeness and contradictions, its form against PTB's schemas if you have them, and its
    signature if it has one. Exit status 0: no fault; 1: faults.
    """
    from bench.commands.dcc_output import show_check

    return show_check(path, schemas=schemas, trusted=trusted, as_json=as_json)


@click.command("from-dcc")
@click.argument("path", metavar="FILE", type=ExistingFile())
@click.option(
    "--quantity", metavar="NAME", default="", help="Id, label or name of the length.  [default: focal length]"
)
@click.option(
    "--trusted",
    type=ExistingFile(),
    metavar="PEM",
    help="Certificates that you trust; the signature must lead to one of them.",
)
@JSON
def from_dcc(path: Path, quantity: str, trusted: Path | None, as_json: bool) -> int:
    """Read the focal length of a collimator from its digital calibration certificate, an XML FILE.

    Prints the lines for the station file and for lab.yaml: value, uncertainty, number, date and hash of the
    certificate. Nothing is written.
    """
    from bench.commands.dcc_output import show_reference

    return show_reference(path, quantity=quantity, trusted=trusted, as_json=as_json)


DCC_COMMANDS = (check, from_dcc)
"""Commands of this module, for the group `certificate`."""
