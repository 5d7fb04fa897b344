"""Kinds of sealed folders, by the file that only this kind has. Packages add kinds by entry points of that name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from bench.base.entry_points import FOLDERS, entry_points, load, missing
from bench.evidence.findings import Derivation, Verification
from bench.record.run_folder import CERTIFICATE, JOURNAL, SOURCES

VerifyRun = Callable[[Path], Verification]

_EXPORTS = (
    r"exports/(opencv|ros_camera_info|kalibr_camchain|boresight)\.yaml|exports/mrcal\.cameramodel|exports/colmap_cameras\.txt"
    r"|exports/metavision\.json|exports/camera-geometry\.json|exports/not-written\.txt"
)
_RESULT_FILES = rf"results\.json|report\.html|views\.h5|passport\.json|VERIFY\.txt|{_EXPORTS}"


def _nothing_known(verify_run: VerifyRun | None) -> Sequence[Derivation]:
    del verify_run
    return ()


@dataclass(frozen=True)
class FolderKind:
    """What `verify` and the instructions in ``VERIFY.txt`` say of a kind of folder.

    Attributes
    ----------
    name
        One word, as in ``--json``.
    noun
        Name in sentences: ``run folder``.
    content
        What the folder is, in VERIFY.txt: ``the record of one run of Starbench``.
    shown
        What stands before the run's name in the answer of `verify`.
    files
        Names that its files may have; None for any.
    instructions
        Further lines of VERIFY.txt about the authorisation.
    canonical
        JSON files that are written in one form only; whether other letters than ASCII are escaped in them.
    checks
        Makes the further checks of a folder, called in order while there is no fault. With ``verify --again`` it gets
        what verifies a run by its recordings, else None.
    """

    name: str
    noun: str
    content: str
    shown: str = "Run"
    files: re.Pattern[str] | None = None
    instructions: str = ""
    canonical: Mapping[str, bool] = field(default_factory=dict)
    checks: Callable[[VerifyRun | None], Sequence[Derivation]] = _nothing_known


_OWN = {
    JOURNAL: FolderKind(
        "run",
        "run folder",
        "the record of one run of Starbench",
        files=re.compile(
            rf"{_RESULT_FILES}|journal\.jsonl|sequence\.yaml|station\.yaml|checked-calibration|plan\.json|wire\.jsonl(\.[0-9]{{1,3}})?"
            r"|captures/pose-[0-9]{3,6}-attempt-[0-9]{1,4}\.[a-z0-9]{1,5}|quarantine/[^/]+\.[0-9]{1,4}"
        ),
    ),
    SOURCES: FolderKind(
        "results",
        "folder of recalculated results",
        "a calibration that Starbench calculated from existing files (a recalculation)",
        "Recalculated results",
        re.compile(rf"{_RESULT_FILES}|sources\.json"),
        """
sources.json names the files that these results were calculated from, with their SHA-256. To check one:
sha256sum FILE.
""",
    ),
}
_OTHER = FolderKind("files", "folder", "a set of files made by Starbench")


def markers() -> Sequence[str]:
    """Return the files that tell kinds apart."""
    return (JOURNAL, *entry_points(FOLDERS), SOURCES)


def folder_kind(folder: Path) -> FolderKind:
    """Return the kind of a folder, by its content. Raises `ExtraMissing` for a kind whose package is not there."""
    for name in markers():
        if (folder / name).is_file():
            return _OWN.get(name) or cast("FolderKind", load(FOLDERS, name))
    if (folder / CERTIFICATE).is_file():  # a person can still check its authorisation
        raise missing(FOLDERS, CERTIFICATE)
    return _OTHER
