"""Works that write, each of which goes on whichever of its calls to the disk fails or kills: run by `test_failing_calls`."""

import json
import os
import sys
from collections import Counter
from datetime import timedelta
from importlib import import_module
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
from authorising import make_key, person
from certificate_lab import FIRST, Lab, quick_files
from certificate_sample import NOW
from drawn_rig import Drawn
from failing_calls import COMMANDS, each_call, remove, tried
from made_event_files import some_events
from virtual_bench import BEGIN, VirtualBench

from bench.base.clock import VirtualClock
from bench.base.errors import UsageError
from bench.commands.cli import main
from bench.evidence.authorisation import authorise
from bench.evidence.key_rotation import rotate
from bench.evidence.key_trust import read_trust
from bench.evidence.keys import ensure_key, load_key
from bench.evidence.signers import SIGNERS_FILE, read_signers, trust
from bench.evidence.states import standing_of
from bench.evidence.verify import verify_folder
from bench.extras.certificate.series import numbers
from bench.record.storage import sha256_of
from bench.solve.exports import camera_info
from calib.model.rotation import exp_map
from calib.target import StarTarget

SIZE = (640, 480)
POSES_DEG = [(5.0, 2.0, 0.0), (-4.0, 5.0, 30.0), (0.5, -6.0, -80.0), (6.0, -3.0, 160.0)]


class Command:
    """A command line that writes one new file or folder, ``out``; it is given again after what failed."""

    def __init__(self, name, *words, inputs):
        self.name, self.words, self.inputs = name, words, inputs

    def prepare(self, folder):
        (folder / "new").mkdir(parents=True)
        os.environ["STARBENCH_HOME"] = str(folder / "home")
        ensure_key(folder / "home", principal="bench@lab")
        return folder

    def do(self, folder):
        filled = {"out": folder / "new" / "out", "in": self.inputs}
        main([word.format_map(filled) for word in self.words])

    def check(self, folder, end):
        if end.status == 0:  # what failed did not matter, as a claim that cannot be removed
            assert self._names(folder, hidden=False) == self._expected()
            return
        if end.status > 0 and not end.failed.startswith(("unlink", "rmdir")):
            assert self._names(folder) == []
        again = tried(lambda: self.do(folder), folder)
        assert again.status == 0, again.said
        assert self._names(folder) == self._expected()

    def _expected(self):
        return [next(Path(word).name for word in self.words if "{out}" in word).format(out="out")]

    def _names(self, folder, *, hidden=True):
        return sorted(p.name for p in (folder / "new").iterdir() if hidden or not p.name.startswith("."))


class Run:
    """A run on virtual devices, and what an operator does next; nothing is lost, and nothing looks changed."""

    name = "run"

    def __init__(self, folder):
        undisturbed = VirtualBench(folder)
        undisturbed.begin()
        self.usual = undisturbed.faults()
        assert {fault.kind for fault in self.usual} <= {"results", "journal"}, self.usual
        remove(folder)

    def prepare(self, folder):
        return VirtualBench(folder)

    def do(self, bench):
        end = bench.begin()
        assert not end.why or str(bench.folder) in end.why, end.why
        assert list(end.unsafe) == []

    def check(self, bench, end):
        stored = bench.stored()
        bench.clock = VirtualClock(BEGIN + timedelta(hours=1))
        bench.finish()
        assert bench.stored()[: len(stored)] == stored
        assert bench.faults() == self.usual
        assert bench.breaks() == []
        of_log = end.failed.endswith("wire.jsonl")
        with_lost_log = any("wire_log_ended_s" in entry.data for entry in bench.entries())
        assert with_lost_log <= of_log


class Issue:
    """A certificate, issued by the same command with the same number."""

    name = "certificate"

    def prepare(self, folder):
        return Lab(new(folder))

    def do(self, lab):
        lab.issue()

    def check(self, lab, end):
        if end.status and lab.numbers() != {FIRST: "issued"}:
            lab.issue()
        elif end.status:  # the line is there, its sync had failed
            try:
                lab.issue()
            except UsageError as told:
                assert f"This folder is the certificate {FIRST}, which is issued" in str(told)  # noqa: PT017
        assert lab.numbers() == {FIRST: "issued"}
        (certificate,) = numbers(lab.ledger.entries()).values()
        assert certificate.seal == sha256_of(lab.path / "certificate" / "SHA256SUMS")
        assert lab.ledger.breaks() == ([], [])


class Authorisation:
    """A person's signature beside the seal of a run: whole or not there."""

    name = "authorisation"

    def prepare(self, folder):
        lab = Lab(new(folder))
        key, signer = person(make_key(folder))
        trust(lab.home, signer.line)
        return lab, key

    def do(self, state):
        lab, key = state
        authorise(lab.run, key, read_trust(lab.home), NOW)

    def check(self, state, end):
        lab, _ = state
        if end.status and standing(lab) != "AUTHORISED":
            self.do(state)
        assert standing(lab) == "AUTHORISED"
        see_that_the_seal_holds(lab)


class Entries:
    """Lines of the ledger of a bench: none is lost, and no break is seen."""

    name = "ledger"

    def prepare(self, folder):
        return Lab(new(folder))

    def do(self, lab):
        place = lab.ledger.begin(run_id="next", folder=lab.run, camera="1", simulated=True)
        lab.ledger.end(place["number"], how="finished", folder=lab.run)
        lab.ledger.append("noted", what="something")

    def check(self, lab, end):
        before = [run.number for run in lab.ledger.runs()]
        self.do(lab)
        assert [run.number for run in lab.ledger.runs()] == list(range(1, len(before) + 2))
        assert end.status or len(before) == 2
        assert lab.ledger.breaks() == ([], [])


class Keys:
    """A change of keys: the bench has one key that is trusted, and it can be changed again."""

    name = "keys"

    def prepare(self, folder):
        return Lab(new(folder))

    def do(self, lab):
        rotate(lab.home, NOW, passphrase=None, keep_old=True)

    def check(self, lab, end):
        own = load_key(lab.home)
        assert own.public_key in {signer.public_key for signer in read_signers(lab.home / SIGNERS_FILE)}
        see_that_the_seal_holds(lab)
        if end.status:
            rotate(lab.home, NOW + timedelta(hours=1), passphrase=None, keep_old=True)
            assert load_key(lab.home).public_key != own.public_key


def new(folder):
    """A new folder."""
    folder.mkdir()
    return folder


def standing(lab):
    """Whether a person has authorised the run."""
    return standing_of(lab.run, read_trust(lab.home), NOW).state.value


def see_that_the_seal_holds(lab):
    """The sample is no whole run, which the verifier tells; its files are those that were sealed, by a trusted key."""
    kinds = {fault.kind for fault in verify_folder(lab.run, read_trust(lab.home)).faults}
    assert kinds <= {"form", "journal", "results"}


def write_inputs(folder):
    """What the commands read: events, views behind a collimator and of boards by two cameras, a camera, a passport."""
    events = some_events(3000)
    np.savez(folder / "a.npz", **{name: events[name] for name in "txyp"}, size=np.array([1280, 720]))
    rig = Drawn(2, boards=10, sizes=(SIZE, SIZE))
    rng, target = np.random.default_rng(4), StarTarget()
    plane = target.positions_mm(target.ids) - target.tag_centre_mm
    disc = (np.linalg.norm(plane, axis=1) < 255.0 * np.tan(np.deg2rad(12.0))) & (target.ids % 3 == 0)
    rays = np.column_stack([plane, np.full(len(plane), 255.0)])[disc]
    for name, views, camera in zip(("left", "right"), rig.views, rig.cameras, strict=True):
        (folder / name).mkdir()
        for view in views:
            rows = np.column_stack([view.points_px + 0.5, view.target_mm, view.ids])
            np.savetxt(folder / name / f"{view.name}.csv", rows, delimiter=",")
        (folder / f"{name}.yaml").write_bytes(camera_info(camera, name, camera.matrix))
    (folder / "stars").mkdir()
    for at, (pan, tilt, roll) in enumerate(POSES_DEG):
        held = exp_map(np.deg2rad([tilt, pan, 0.0])) @ exp_map(np.deg2rad([0.0, 0.0, roll]))
        seen = rig.cameras[0].project(rays @ held.T) + 0.05 * rng.standard_normal((len(rays), 2))
        inside = ((seen > 3) & (seen < np.array(SIZE) - 4)).all(axis=1)
        rows = np.column_stack([seen + 0.5, target.positions_mm(target.ids)[disc], target.ids[disc]])[inside]
        np.savetxt(folder / "stars" / f"{at}.csv", rows, delimiter=",")


def commands(inputs):
    """Every command that writes a new file or folder, by its name."""
    size, board = ("--image-size", "640x480"), ("--board", "checkerboard:11x7:20mm")
    kinds = ("raw", "metavision", "hdf5", "parquet", "csv")
    lines = [
        *(("convert", "{in}/a.npz", "{out}", "--as", kind) for kind in kinds),
        ("convert", "{in}/a.h5", "{out}", "--as", "numpy"),
        ("target", "-s", "simulated", "-o", "{out}.svg"),
        ("station", "new", "{out}", "--stand-ins", "keysight"),
        ("certificate", "new", "{out}"),
        ("undistort", "{in}/left.yaml", "-o", "{out}"),
        ("passport", "make", "{in}/stars", *size, "-o", "{out}"),
        ("calibrate", "{in}/stars", *size, "-o", "{out}"),
        ("rig", "{in}/left", "{in}/right", *board, *size, "-o", "{out}"),
    ]
    pairs = zip(COMMANDS, lines, strict=True)
    return {name: Command(name, *words, inputs=inputs) for name, words in pairs}


def once(module, name):
    """Let a function be calculated once, and return that ever after: it writes nothing."""
    real, known = getattr(import_module(module), name), {}

    def call(*words, **more):
        if not known:
            known[0] = real(*words, **more)
        return known[0]

    return mock.patch(f"{module}.{name}", call)


OTHERS = {"run": Run, "certificate": Issue, "authorisation": Authorisation, "ledger": Entries, "keys": Keys}


def try_works(folder, steps):
    """Let the calls of works fail, every so many of each by name; tell how many of each kind, and return what fell."""
    inputs = new(folder / "inputs")
    write_inputs(inputs)
    by_name, fallen = commands(inputs), []
    os.environ["STARBENCH_HOME"] = str(folder / "home")
    tried(lambda: main(["convert", str(inputs / "a.npz"), str(inputs / "a.h5")]), folder)
    patches = [
        once("bench.solve.offline", "calibrate_paths"),
        once("bench.solve.offline_folder", "shown_files"),
        once("bench.solve.rig", "find_rig"),
        mock.patch("bench.extras.certificate.issue.certificate_files", quick_files),
        mock.patch("bench.extras.certificate.pdf.plots_of_run", return_value={}),
    ]
    for patch in patches:
        patch.start()
    for name, (first, step) in steps.items():
        if name in OTHERS:
            work = OTHERS[name](folder / "first") if name == "run" else OTHERS[name]()
        else:
            work = by_name[name]
            try:  # what is loaded and calculated now is there in each fork
                work.do(work.prepare(folder / "first"))
            except SystemExit as end:
                if end.code:
                    raise
            remove(folder / "first")
        counted, fell = each_call(work, folder / "here", first=first, step=step)
        names = Counter()
        for kind, count in counted.items():
            names[kind.partition(" ")[0]] += count
        print(f"{name}: {counted.total()} calls failed or killed: {dict(names)}", *fell, sep="\n", flush=True)
        fallen += fell
    return fallen


if __name__ == "__main__":
    cv2.setNumThreads(1)
    sys.exit(bool(try_works(Path(sys.argv[1]), json.loads(sys.argv[2]))))
