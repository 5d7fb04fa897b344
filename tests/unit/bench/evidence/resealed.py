"""What a verification found; and folders sealed again by whoever holds the bench's key and the program."""

import hashlib
import json
import shutil
from datetime import datetime

from bench.base.bounded_json import canonical_json
from bench.evidence.seal import make_manifest
from bench.evidence.signers import NAMESPACE
from bench.measure.views_file import read_views, views_file
from bench.record.journal import read_journal
from bench.record.journal_line import FIRST_PREV, encode_line
from bench.record.recovery import written_files
from bench.record.stored_calibration import stored_calibration
from bench.record.stored_run import results_of
from bench.report.html import ReportData, render_report
from bench.report.pictured_poses import pictured_poses
from bench.solve.exports import exports


def kinds(verification):
    return sorted((f.kind, f.where) for f in verification.faults)


def reseal(folder, key, namespace=NAMESPACE):
    (folder / "SHA256SUMS").write_bytes(manifest := make_manifest(folder))
    (folder / "SHA256SUMS.sig").write_bytes(key.sign(manifest, namespace))


def copied(folder, to):
    """Copy a sealed run; the copy may be written to."""
    shutil.copytree(folder, to)
    return writable(to)


def writable(folder):
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return folder


class Forger:
    """Somebody with the bench's key and the program, who changes a sealed run and puts the rest right again."""

    def __init__(self, folder, key):
        self.folder, self.key = folder, key
        self.head = ""

    def __truediv__(self, name):
        return self.folder / name

    # ------------------------------------------------------------------ files

    def replace(self, name, old, new, count=1):
        path = self.folder / name
        data = path.read_bytes()
        old, new = (part.encode() if isinstance(part, str) else part for part in (old, new))
        assert old in data, f"{old!r} is not in {name}"
        path.write_bytes(data.replace(old, new, count))

    @property
    def results(self):
        return json.loads((self.folder / "results.json").read_bytes())

    def edit_json(self, name, change):
        content = json.loads((self.folder / name).read_bytes())
        change(content)
        (self.folder / name).write_bytes(canonical_json(content))

    def edit_results(self, change):
        self.edit_json("results.json", change)

    # ------------------------------------------------------------------ journal

    @property
    def lines(self):
        """The journal's lines, as [event, utc, mono_s, data]."""
        return [
            [entry.event, entry.utc, entry.mono_s, dict(entry.data)]
            for entry in read_journal(self.folder / "journal.jsonl")[0]
        ]

    def chain(self, lines):
        """Write a journal of these lines, chained. The report prints the hash of the line before `written`."""
        head = next(
            (str(data["head"]) for event, _, _, data in lines if event == "written" and "head" in data), None
        )
        prev, written = FIRST_PREV, []
        for seq, (event, utc, mono_s, data) in enumerate(lines):
            if event == "written":
                data["head"] = self.head = prev
            line = encode_line(seq, datetime.fromisoformat(utc), mono_s, event, data, prev)
            prev = json.loads(line)["hash"]
            written.append(line + b"\n")
        (self.folder / "journal.jsonl").write_bytes(b"".join(written))
        if head is not None and self.head != head and (self.folder / "report.html").exists():
            self.replace("report.html", head, self.head, -1)

    def edit_journal(self, change):
        """Change lines: `change` gets [event, utc, mono_s, data] of each, and returns it, another one or None."""
        kept = [changed for line in self.lines if (changed := change(line)) is not None]
        self.chain(kept)

    def edit_line(self, event, change, *, nth=0):
        """Change the data of the nth line of an event."""
        lines = self.lines
        of_event = [line for line in lines if line[0] == event]
        change(of_event[nth][3])
        self.chain(lines)

    # ------------------------------------------------------------------ what follows

    def tell_of_files(self):
        """Put the hashes of documents, recordings and results into the journal's lines, and chain it again."""
        sums = {
            path.relative_to(self.folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in self.folder.rglob("*")
            if path.is_file()
        }
        lines = self.lines
        for event, _, _, data in lines:
            if event == "run_started":
                data["sha256"] = {name: sums[name] for name in data["sha256"] if name in sums}
            elif event == "capture_stored" and data["capture"] in sums:
                data["sha256"] = sums[data["capture"]]
                data["size"] = (self.folder / data["capture"]).stat().st_size
        self.chain(lines)
        for line in lines:
            if line[0] == "written":
                line[3]["files"] = written_files(self.folder)
        self.chain(lines)

    def render(self, job):
        """Make exports and report again of the results, as the program does."""
        results = results_of(canonical_json(self.results), self.folder / "results.json")
        self.chain(self.lines)
        calibration = stored_calibration(results["calibration"])
        for name, data in exports(calibration, camera_name=job.camera_name, target=job.target).items():
            (self.folder / "exports" / name).write_bytes(data)
        names = pictured_poses(results).names
        held = read_views(self.folder / "views.h5")
        shown = [held_view.shown(pictured=held_view.view.name in names) for held_view in held]
        html = render_report(ReportData(results, shown, self.head))
        (self.folder / "report.html").write_text(html, encoding="utf-8")

    def write_views(self, held):
        (self.folder / "views.h5").write_bytes(views_file(held))

    def seal(self):
        reseal(self.folder, self.key)
