"""Descriptions of devices: YAML files that say how a stage or a light is talked to, without code.

The module finds and reads such a file strictly, every fault at its line and column. It opens no device.
docs/devices-by-description.md describes every key.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bench.stations.light_description import LightProtocol
from bench.stations.stage_description import StageProtocol
from sequences.reader import Located, find_document, read_document

SHIPPED_DESCRIPTIONS: Final = Path(__file__).parent / "descriptions"


def read_stage_protocol(path: Path) -> Located[StageProtocol]:
    """Read the description of a stage."""
    return read_document(path, StageProtocol)


def read_light_protocol(path: Path) -> Located[LightProtocol]:
    """Read the description of a light."""
    return read_document(path, LightProtocol)


def find_description(name_or_path: str, folder: Path | None) -> Path:
    """Find the file of a description.

    name_or_path: Name of a shipped description, or a path.
    folder: Folder to which a path is relative; None for the working directory.
    Returns: The file, which need not exist if a path was given.
    Raises DocumentFaults: If a bare name is neither a file nor shipped; the message lists the shipped names.
    """
    path = Path(name_or_path)
    if folder is not None and (path.name != name_or_path or path.suffix):
        return folder / path
    return find_document(name_or_path, SHIPPED_DESCRIPTIONS)
