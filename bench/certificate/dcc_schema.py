"""Checks a digital calibration certificate against the schema files of PTB, which the user supplies, without network.

Starbench does not ship the schemas (LGPL-3.0, PTB). A folder holds them unchanged: ``dcc.xsd`` and ``SI_Format.xsd``.
Their imports name addresses in the network; a resolver maps these to the files of the folder. The schema of XML
signatures, ``xmldsig-core-schema.xsd``, is taken from the folder or, if it is not there, from signxml.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base.errors import EvidenceError, UsageError
from bench.certificate.dcc_xml import DCC, DS, NAMESPACES, SI, Versions, library, read_dcc, short, versions_of

if TYPE_CHECKING:
    from lxml.etree import XMLSchema, _Element

SCHEMAS_VARIABLE = "STARBENCH_DCC_SCHEMAS"
DCC_SCHEMA = "dcc.xsd"
SI_SCHEMA = "SI_Format.xsd"
SIGNATURE_SCHEMA = "xmldsig-core-schema.xsd"
_FILES = {DCC: DCC_SCHEMA, SI: SI_SCHEMA, DS: SIGNATURE_SCHEMA}
_XS = "{http://www.w3.org/2001/XMLSchema}"
_MOST_BYTES = 4 * 1024 * 1024
_MOST_FAULTS = 50
_REMEDY = (
    "Get dcc.xsd and SI_Format.xsd of the certificate's version from PTB (https://ptb.de/dcc, https://ptb.de/si), put"
    f" both into one folder, and name it with --schemas or in {SCHEMAS_VARIABLE}."
)


def schema_folder(given: Path | None, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder of the schemas.

    given: The folder that the user named; None for that of the environment.
    Returns: The folder; None if none is named.
    """
    if given is not None:
        return given
    named = environ.get(SCHEMAS_VARIABLE, "").strip()
    return Path(named) if named else None


def schema_faults(data: bytes, folder: Path, where: str) -> list[str]:
    """Check a DCC against the schemas of its version.

    Returns: One line a fault, as ``line N: what``; empty if the DCC is valid. At most 50.
    Raises EvidenceError: When the DCC cannot be read.
    Raises UsageError: When the folder has no schemas of the DCC's version, or lxml is not installed.
    """
    root = read_dcc(data, where)
    schema = load_schema(folder, versions_of(root, where))
    if schema.validate(root):
        return []
    lines = [
        f"line {entry.line}: {_plain(entry.message)}"
        for entry in schema.error_log  # type: ignore[attr-defined]
    ]
    more = [f"and {len(lines) - _MOST_FAULTS} more"] if len(lines) > _MOST_FAULTS else []
    return [*lines[:_MOST_FAULTS], *more]


def load_schema(folder: Path, versions: Versions) -> XMLSchema:
    """Load the schemas of a folder.

    versions: The versions that the schemas must have.
    Raises UsageError: When a file is missing, is not a schema or has another version, or lxml is not
      installed.
    """
    etree = library("lxml.etree")
    if not folder.is_dir():
        raise UsageError("There is no such folder of schemas.", where=str(folder), remedy=_REMEDY)
    contents = {
        DCC_SCHEMA: _schema_bytes(folder / DCC_SCHEMA, DCC, versions.dcc),
        SI_SCHEMA: _schema_bytes(folder / SI_SCHEMA, SI, versions.si),
        SIGNATURE_SCHEMA: _signature_schema(folder),
    }
    parser = _parser(etree)
    parser.resolvers.add(_resolver(etree, contents))
    try:
        return etree.XMLSchema(etree.fromstring(contents[DCC_SCHEMA], parser))
    except (etree.XMLSchemaParseError, etree.XMLSyntaxError) as error:
        raise UsageError(
            f"The schemas cannot be used: {_plain(str(error))}.", where=str(folder), remedy=_REMEDY
        ) from error


def _parser(etree: Any) -> Any:
    return etree.XMLParser(no_network=True, load_dtd=False, resolve_entities=False, huge_tree=False)


def _resolver(etree: Any, contents: Mapping[str, bytes]) -> Any:
    """Return a resolver that answers every address with a file of the folder, and refuses all others."""

    class Resolver(etree.Resolver):  # type: ignore[misc]
        def resolve(self, system_url: str, public_id: str, context: Any) -> Any:
            del public_id
            content = contents.get(system_url.rsplit("/", 1)[-1])
            if content is None:
                raise EvidenceError(
                    f"The schema asks for {short(system_url)}, which is not one of its files."
                )
            return self.resolve_string(content, context, base_url=system_url)

    return Resolver()


def _schema_bytes(path: Path, namespace: str, version: str) -> bytes:
    """Return the bytes of a schema after checking its namespace, its version and what it imports."""
    etree = library("lxml.etree")
    if not path.is_file():
        raise UsageError(
            f"The folder has no {path.name}, which the check needs.", where=str(path.parent), remedy=_REMEDY
        )
    if path.stat().st_size > _MOST_BYTES:
        raise UsageError("The file is too large for a schema.", where=str(path), remedy=_REMEDY)
    content = path.read_bytes()
    try:
        root: _Element = etree.fromstring(content, _parser(etree))
    except (etree.XMLSyntaxError, ValueError) as error:
        raise UsageError(
            f"The file is not an XML schema ({short(str(error))}).", where=str(path), remedy=_REMEDY
        ) from error
    if root.tag != f"{_XS}schema" or root.get("targetNamespace") != namespace:
        raise UsageError(f"The file is not the schema of {namespace}.", where=str(path), remedy=_REMEDY)
    if root.get("version") != version:
        stated = short(root.get("version", "")) or "none"
        raise UsageError(
            f"The schema has version {stated}; the certificate needs {version}.",
            where=str(path),
            remedy=_REMEDY,
        )
    for imported in root.iter(f"{_XS}import", f"{_XS}include", f"{_XS}redefine"):
        name = imported.get("schemaLocation", "").rsplit("/", 1)[-1]
        if _FILES.get(imported.get("namespace", "")) != name:
            raise UsageError(
                f"The schema imports {short(imported.get('schemaLocation', ''))}, which is not known here.",
                where=str(path),
                remedy=_REMEDY,
            )
    return content


def _signature_schema(folder: Path) -> bytes:
    """Return the schema of XML signatures: that of the folder, else that of signxml."""
    own = folder / SIGNATURE_SCHEMA
    if own.is_file():
        return own.read_bytes()
    shipped = Path(str(library("signxml").__file__)).parent / "schemas" / SIGNATURE_SCHEMA
    if shipped.is_file():
        return shipped.read_bytes()
    raise UsageError(f"The folder has no {SIGNATURE_SCHEMA}.", where=str(folder), remedy=_REMEDY)


def _plain(message: str) -> str:
    """Return a message of libxml2 with prefixes for its namespaces."""
    for prefix, namespace in NAMESPACES.items():
        message = message.replace(f"{{{namespace}}}", f"{prefix}:")
    return short(re.sub(r"\.$", "", message.strip()), 300)
