"""Verify a sealed run folder: signature, files, journal, results and report.

The verifier writes nothing, trusts nothing in the folder, and reports all faults, not only the first one. The trusted
keys come from outside the folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import zip_longest
from pathlib import Path
from typing import Any

from bench import __version__
from bench.base.errors import EvidenceError, RunFolderError
from bench.evidence.faults import SealFault
from bench.evidence.keys import NAMESPACE, Signer
from bench.evidence.seal import NOT_LISTED, list_files, read_manifest
from bench.evidence.sshsig import fingerprint, is_valid, read_signature
from bench.records.captures import stored_captures
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL, MANIFEST, REPORT, RESULTS, SIGNATURE
from bench.records.storage import sha256_of, storage_errors

_LARGEST_SEAL_BYTES = 64 << 20
_LARGEST_TEXT_BYTES = 1 << 30
"""Seals, and results and reports of ten thousand poses, are smaller; a larger file is not read."""


_NOT_RESULTS = (ValueError, LookupError, TypeError, RecursionError)
"""Exceptions raised by reading JSON that is not of the expected form."""


@dataclass(frozen=True)
class Verification:
    """What the checks found.

    Attributes
    ----------
    folder
        The run folder.
    faults
        All faults; empty when the folder is as a trusted bench sealed it.
    remarks
        What could not be checked, and why.
    signer, fingerprint
        Name of the signer in the list of trusted keys (None when the key is not in it), and fingerprint of the key.
    files
        Number of files in the list of the seal.
    run_id, camera_serial
        Run and camera that the results name; the reader compares them with the expected ones.
    simulated
        Whether the devices were simulated; None when the results do not state it.
    """

    folder: str
    faults: Sequence[SealFault] = ()
    remarks: Sequence[str] = ()
    signer: str | None = None
    fingerprint: str | None = None
    files: int = 0
    run_id: str | None = None
    camera_serial: str | None = None
    simulated: bool | None = None

    @property
    def ok(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    def to_dict(self) -> dict[str, Any]:
        """Return the verification as JSON carries it.

        Returns
        -------
        dict
            ``ok``, and all attributes.
        """
        return {"ok": self.ok, **asdict(self), "faults": [asdict(fault) for fault in self.faults]}


def verify_run(
    folder: Path,
    signers: Iterable[Signer],
    *,
    when: datetime | None = None,
    camera_serial: str | None = None,
    recalculate: Callable[[Path], Sequence[str]] | None = None,
) -> Verification:
    """Check a sealed run folder.

    Parameters
    ----------
    folder
        The run folder.
    signers
        Trusted keys, from `bench.evidence.keys.read_signers`.
    when
        Moment at which the signer's key must be valid, with its time zone; None for now.
    camera_serial
        Serial number that the calibrated camera must have; None for any. It reveals a report of another camera.
    recalculate
        Calibrates again from the recordings and returns a sentence for each value that differs
        (`bench.results.reproduce.differences`); None: this is not checked. It is a parameter so that the verifier
        itself does not import the calibration engine.

    Returns
    -------
    Verification
        All faults and remarks.

    Raises
    ------
    RunFolderError
        When there is no such folder, or it is not a run folder.
    StorageError
        When a file cannot be read.
    """
    if not folder.is_dir() or not any((folder / name).exists() for name in (MANIFEST, JOURNAL)):
        raise RunFolderError(
            "This is not a run folder.",
            where=str(folder),
            remedy="Name the folder that a run was written to.",
        )
    check = _Check(folder)
    with storage_errors(folder):
        manifest = check.signature(list(signers), when or datetime.now(UTC))
        if manifest is not None:
            check.files(manifest)
        captures = check.journal()
        facts = check.results(captures, manifest, camera_serial)
        if not check.faults and facts is not _NO_RESULTS:
            check.report()
        if recalculate is not None and not check.faults and facts is not _NO_RESULTS:
            check.calibration(recalculate)
    return Verification(
        folder=str(folder),
        faults=tuple(check.faults),
        remarks=tuple(check.remarks),
        signer=check.signer,
        fingerprint=check.fingerprint,
        files=len(manifest or ()),
        run_id=facts.run_id,
        camera_serial=facts.camera_serial,
        simulated=facts.simulated,
    )


@dataclass
class _Check:
    """The checks of one folder; each adds its faults."""

    folder: Path
    faults: list[SealFault] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    signer: str | None = None
    fingerprint: str | None = None

    def fault(self, kind: str, where: str, what: str) -> None:
        self.faults.append(SealFault(kind, where, what))

    def signature(self, signers: list[Signer], when: datetime) -> dict[str, str] | None:
        """Check the signature of the list of files; return the list, or None if the folder is not sealed."""
        for name in (MANIFEST, SIGNATURE):
            path = self.folder / name
            if path.is_symlink() or not path.is_file():
                why = "this is a link, not a file" if path.is_symlink() else "the file is missing"
                self.fault("unsealed", name, f"{why}; this folder is not sealed")
                return None
            if self._too_large("manifest", name):
                return {}
        manifest = (self.folder / MANIFEST).read_bytes()
        try:
            signature = read_signature((self.folder / SIGNATURE).read_bytes())
            self.fingerprint = fingerprint(signature.public_key)
            if signature.namespace != NAMESPACE:
                self.fault(
                    "signature", SIGNATURE, f"the signature is for {signature.namespace!r}, not for a report"
                )
            if not is_valid(signature, manifest):
                self.fault("signature", SIGNATURE, f"the signature does not match this {MANIFEST}")
            self._key(signature.public_key, signers, when)
        except EvidenceError as error:
            self.fault("signature", SIGNATURE, error.what)
        try:
            return read_manifest(manifest)
        except EvidenceError as error:
            self.fault("manifest", error.where, error.what)
            return {}

    def _key(self, public_key: bytes, signers: list[Signer], when: datetime) -> None:
        known = [signer for signer in signers if signer.public_key == public_key]
        rejections = [signer.rejection(NAMESPACE, when) for signer in known]
        if None in rejections:
            self.signer = known[rejections.index(None)].principal
        elif known:
            self.fault("key", SIGNATURE, str(rejections[0]))
        else:
            self.fault(
                "key",
                SIGNATURE,
                f"the key that signed is not in the list of trusted keys ({self.fingerprint})",
            )

    def files(self, manifest: Mapping[str, str]) -> None:
        """Check that the folder has exactly the listed files, unchanged."""
        found = list_files(self.folder)
        for name, kind in sorted(found.items()):
            if kind != "file":
                self.fault("link" if kind == "link" else "added", name, f"this is a {kind}, not a file")
            elif name not in manifest and name not in NOT_LISTED:
                self.fault("added", name, "the file was added after sealing")
        for name, sha256 in manifest.items():
            if name not in found:
                self.fault("missing", name, "the file is missing")
            elif found[name] == "file" and sha256_of(self.folder / name) != sha256:
                self.fault("changed", name, "the file was changed after sealing")

    def journal(self) -> dict[str, str]:
        """Check the hash chain of the journal; return the SHA-256 of the recordings that it names."""
        path = self.folder / JOURNAL
        if path.is_symlink() or not path.is_file():
            self.fault("journal", JOURNAL, "the file is missing")
            return {}
        try:
            entries, torn = read_journal(path)
            captures = stored_captures(entries)
        except RunFolderError as error:
            self.fault("journal", error.where.removeprefix(f"{self.folder}/") or JOURNAL, error.what)
            return {}
        if torn:
            self.fault("journal", JOURNAL, "its last line is incomplete")
        return {name: capture.sha256 for name, capture in captures.items()}

    def results(
        self, captures: Mapping[str, str], manifest: Mapping[str, str] | None, camera_serial: str | None
    ) -> _ResultFacts:
        """Check that results, journal and list of files name the same recordings."""
        path = self.folder / RESULTS
        if path.is_symlink() or not path.is_file():
            return _NO_RESULTS  # a failed run has no results; if they were removed, a listed file is missing
        if self._too_large("results", RESULTS):
            return _NO_RESULTS
        try:
            facts = _facts_of(json.loads(path.read_bytes()))
        except _NOT_RESULTS as error:
            self.fault("results", RESULTS, f"the file cannot be read ({error!r})")
            return _NO_RESULTS
        sources = {"the journal": captures} | ({} if manifest is None else {MANIFEST: manifest})
        for name, sha256 in facts.captures:
            for source, hashes in sources.items():
                if hashes.get(name) != sha256:
                    self.fault("results", RESULTS, f"{source} does not name {name} with this hash")
        if camera_serial is not None and facts.camera_serial != camera_serial:
            self.fault(
                "item",
                RESULTS,
                f"the results belong to camera {facts.camera_serial}; {camera_serial} was requested",
            )
        return facts

    def report(self) -> None:
        """Check that the report prints the results: render it again and compare every word."""
        import jinja2

        from bench.report.html import ReportData, printed_text, render_report

        path = self.folder / REPORT
        if not path.is_file() or self._too_large("report", REPORT):
            return
        results = json.loads((self.folder / RESULTS).read_bytes())
        made_by = results["run"].get("software", {}).get("starbench")
        if made_by != __version__:
            self.remarks.append(
                f"{REPORT} was not compared with {RESULTS}: Starbench {made_by} wrote it, this is {__version__}"
            )
            return
        printed = printed_text(path.read_text(encoding="utf-8", errors="replace"))
        hashes = {entry.hash for entry in read_journal(self.folder / JOURNAL)[0]}
        head = next((word for word in printed if word in hashes), None)
        if head is None:
            self.fault("report", REPORT, "the report names no line of this journal")
            return
        try:
            wanted = printed_text(render_report(ReportData(results, (), head), draw=False))
        except (*_NOT_RESULTS, AttributeError, ArithmeticError, jinja2.TemplateError) as error:
            self.fault("results", RESULTS, f"no report can be made of these results ({error!r})")
            return
        for had, due in zip_longest(printed, wanted, fillvalue=""):
            if had != due:
                self.fault("report", REPORT, f"the report prints {had!r} where {RESULTS} gives {due!r}")
                return

    def calibration(self, recalculate: Callable[[Path], Sequence[str]]) -> None:
        """Check that the results follow from the recordings."""
        try:
            found = list(recalculate(self.folder))
        except _NOT_RESULTS as error:
            found = [f"the results have no calibration to compare ({error!r})"]
        for difference in found:
            self.fault("results", RESULTS, difference)

    def _too_large(self, kind: str, name: str) -> bool:
        limit = _LARGEST_SEAL_BYTES if name in NOT_LISTED else _LARGEST_TEXT_BYTES
        if (self.folder / name).stat().st_size <= limit:
            return False
        self.fault(kind, name, f"the file is too large: more than {limit} bytes")
        return True


@dataclass(frozen=True)
class _ResultFacts:
    """Run and camera that results name, and the recordings they were made from."""

    run_id: str | None = None
    camera_serial: str | None = None
    simulated: bool | None = None
    captures: Sequence[tuple[str, str]] = ()


_NO_RESULTS = _ResultFacts()


def _facts_of(results: Any) -> _ResultFacts:
    """Read the results of a run. Raises KeyError, TypeError or ValueError."""
    return _ResultFacts(
        run_id=str(results["run"]["id"]),
        camera_serial=str(results["devices"]["camera"]["serial"]),
        simulated=bool(results["run"]["simulated"]),
        captures=tuple(
            (str(attempt["capture"]), str(attempt["sha256"]))
            for pose in results["poses"]
            for attempt in pose["attempts"]
            if attempt["capture"] is not None
        ),
    )
