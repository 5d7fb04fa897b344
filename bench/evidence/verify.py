"""Whether a sealed run folder is what the bench sealed: signature, files, journal, and what is printed.

Reads only, trusts nothing in the folder, and finds every fault rather than the first. The keys to trust
come from outside the folder.
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
from bench.evidence.keys import NAMESPACE, Signer
from bench.evidence.seal import NOT_LISTED, list_files, read_manifest
from bench.evidence.sshsig import fingerprint, is_valid, read_signature
from bench.records.captures import stored_captures
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL, MANIFEST, REPORT, RESULTS, SIGNATURE
from bench.records.storage import sha256_of, storage_errors

_LARGEST_SEAL_BYTES = 64 << 20
_LARGEST_TEXT_BYTES = 1 << 30
"""Seals, and results and reports of ten thousand poses, are smaller; what is larger is not read."""


_NOT_RESULTS = (ValueError, LookupError, TypeError, RecursionError)
"""What reading JSON of another form ends in."""


@dataclass(frozen=True)
class Fault:
    """One thing that does not hold.

    Attributes
    ----------
    kind
        ``unsealed``, ``signature``, ``key``, ``manifest``, ``added``, ``changed``, ``missing``, ``link``,
        ``journal``, ``results``, ``report`` or ``item``.
    where
        The file it concerns, within the folder.
    what
        What is wrong.
    """

    kind: str
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


@dataclass(frozen=True)
class Verification:
    """What the checks found.

    Attributes
    ----------
    folder
        The run folder.
    faults
        Everything that does not hold; empty when the bundle is as it was sealed by a trusted bench.
    remarks
        What could not be checked, and why.
    signer, fingerprint
        Who signed, by the list of trusted keys (None when nobody trusted did), and with which key.
    files
        Number of files that the seal lists.
    run_id, camera_serial
        What the results say they are about, to hold against what one expects.
    simulated
        Whether the devices were simulated; None when the results do not say.
    """

    folder: str
    faults: Sequence[Fault] = ()
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
        """Give it as JSON can hold it."""
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
        Trusted keys, as ``keys.read_signers`` gives them.
    when
        Moment at which the signer's key must be valid; the default is now.
    camera_serial
        Serial number that the calibrated camera must have, against a report passed off for another.
    recalculate
        Calibrates again from the recordings and returns a sentence for each value that differs
        (`bench.results.reproduce.differences`); None: this is not checked. It is passed in, so that the verifier itself
        needs no engine.

    Raises
    ------
    RunFolderError
        When there is no such folder, or it is not a run folder.
    StorageError
        When a file cannot be read.
    """
    if not folder.is_dir() or not any((folder / name).exists() for name in (MANIFEST, JOURNAL)):
        raise RunFolderError(
            "This is not a run folder.", where=str(folder), remedy="Name the folder a run was written to."
        )
    check = _Check(folder)
    with storage_errors(folder):
        manifest = check.signature(list(signers), when or datetime.now(UTC))
        check.files(manifest)
        told = check.journal()
        facts = check.results(told, manifest, camera_serial)
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
        files=len(manifest),
        run_id=facts.run_id,
        camera_serial=facts.camera_serial,
        simulated=facts.simulated,
    )


@dataclass
class _Check:
    """The checks of one folder, each adding its faults."""

    folder: Path
    faults: list[Fault] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    signer: str | None = None
    fingerprint: str | None = None

    def fault(self, kind: str, where: str, what: str) -> None:
        self.faults.append(Fault(kind, where, what))

    def signature(self, signers: list[Signer], when: datetime) -> dict[str, str]:
        """Check the signature under the list of files; return the list."""
        for name in (MANIFEST, SIGNATURE):
            path = self.folder / name
            if path.is_symlink() or not path.is_file():
                self.fault("unsealed", name, "it is not there: this folder is not sealed")
                return {}
            if self._too_large("manifest", name):
                return {}
        manifest = (self.folder / MANIFEST).read_bytes()
        try:
            signature = read_signature((self.folder / SIGNATURE).read_bytes())
            self.fingerprint = fingerprint(signature.public_key)
            if signature.namespace != NAMESPACE:
                self.fault(
                    "signature", SIGNATURE, f"it is a signature for {signature.namespace!r}, not for a report"
                )
            if not is_valid(signature, manifest):
                self.fault("signature", SIGNATURE, f"it is not the signature of this {MANIFEST}")
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
        objections = [signer.rejection(NAMESPACE, when) for signer in known]
        if None in objections:
            self.signer = known[objections.index(None)].principal
        elif known:
            self.fault("key", SIGNATURE, str(objections[0]))
        else:
            self.fault("key", SIGNATURE, f"it was made with a key you do not trust ({self.fingerprint})")

    def files(self, manifest: Mapping[str, str]) -> None:
        """Check that exactly the listed files are there, unchanged."""
        found = list_files(self.folder)
        for name, kind in sorted(found.items()):
            if kind != "file":
                self.fault("link" if kind == "link" else "added", name, f"a {kind} in place of a file")
            elif name not in manifest and name not in NOT_LISTED:
                self.fault("added", name, "it was added after sealing")
        for name, sha256 in manifest.items():
            if name not in found:
                self.fault("missing", name, "it is missing")
            elif found[name] == "file" and sha256_of(self.folder / name) != sha256:
                self.fault("changed", name, "it was changed after sealing")

    def journal(self) -> dict[str, str]:
        """Check the chain of the journal; return the captures it tells of, with their hashes."""
        path = self.folder / JOURNAL
        if path.is_symlink() or not path.is_file():
            self.fault("journal", JOURNAL, "it is not there")
            return {}
        try:
            entries, torn = read_journal(path)
            captures = stored_captures(entries)
        except RunFolderError as error:
            self.fault("journal", error.where.removeprefix(f"{self.folder}/") or JOURNAL, error.what)
            return {}
        if torn:
            self.fault("journal", JOURNAL, "its last line is half-written")
        return {name: capture.sha256 for name, capture in captures.items()}

    def results(
        self, told: Mapping[str, str], manifest: Mapping[str, str], camera_serial: str | None
    ) -> _ResultFacts:
        """Check that results, journal and list of files speak of the same recordings."""
        path = self.folder / RESULTS
        if path.is_symlink() or not path.is_file():
            return _NO_RESULTS  # a run that failed has none; one that had them lacks a listed file
        if self._too_large("results", RESULTS):
            return _NO_RESULTS
        try:
            facts = _facts_of(json.loads(path.read_bytes()))
        except _NOT_RESULTS as error:
            self.fault("results", RESULTS, f"it cannot be read ({error!r})")
            return _NO_RESULTS
        for name, sha256 in facts.captures:
            for source, hashes in (("the journal", told), (MANIFEST, manifest)):
                if hashes.get(name) != sha256:
                    self.fault("results", RESULTS, f"{source} does not name {name} with this hash")
        if camera_serial is not None and facts.camera_serial != camera_serial:
            self.fault("item", RESULTS, f"it is about camera {facts.camera_serial}, not {camera_serial}")
        return facts

    def report(self) -> None:
        """Check that the report prints what the results say: render it again and compare every word."""
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
            self.fault("report", REPORT, "it names no line of this journal")
            return
        try:
            wanted = printed_text(render_report(ReportData(results, (), head), draw=False))
        except (*_NOT_RESULTS, AttributeError, ArithmeticError, jinja2.TemplateError) as error:
            self.fault("results", RESULTS, f"no report can be made of it ({error!r})")
            return
        for had, due in zip_longest(printed, wanted, fillvalue=""):
            if had != due:
                self.fault("report", REPORT, f"it prints {had!r} where {RESULTS} gives {due!r}")
                return

    def calibration(self, recalculate: Callable[[Path], Sequence[str]]) -> None:
        """Check that the results follow from the recordings."""
        try:
            found = list(recalculate(self.folder))
        except _NOT_RESULTS as error:
            found = [f"it holds no calibration to compare ({error!r})"]
        for difference in found:
            self.fault("results", RESULTS, difference)

    def _too_large(self, kind: str, name: str) -> bool:
        most = _LARGEST_SEAL_BYTES if name in NOT_LISTED else _LARGEST_TEXT_BYTES
        if (self.folder / name).stat().st_size <= most:
            return False
        self.fault(kind, name, "it is too large to be one")
        return True


@dataclass(frozen=True)
class _ResultFacts:
    """What results say they are about, and from which recordings they were made."""

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
