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
from drawn_rig import Drawn
from failing_calls import each_call, remove, tried
from made_event_files import some_events
from quick_runs import write_queue
from sealed_bench import NOW, SealedBench
from virtual_bench import BEGIN, VirtualBench

from bench.base.clock import VirtualClock
from bench.commands.cli import main
from bench.evidence.authorisation import authorise
from bench.evidence.key_rotation import rotate
from bench.evidence.key_trust import read_trust
from bench.evidence.keys import ensure_key, key_to_seal, load_key, require_usable, usable_key
from bench.evidence.signers import NAMESPACE, SIGNERS_FILE, read_signers, trust
from bench.evidence.states import standing_of
from bench.evidence.verify import verify_folder
from bench.solve.passports import sealed_bytes
from bench.work.workers import Serial
from calib.model.passport import Passport

SIZE = (640, 480)


class Command:
    """A command line that writes one new file or folder, ``out``; it is given again after what failed.

    One that ``goes_on`` keeps what it has done in the folder, and the same command does the rest.
    """

    def __init__(self, name, words, inputs, *, goes_on=False):
        self.name, self.words, self.inputs, self.goes_on = name, words.split(), inputs, goes_on

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
        if end.status > 0 and not self.goes_on and not end.failed.startswith(("unlink", "rmdir")):
            assert self._names(folder) == [], (self._names(folder), end)
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

    usual = None
    """What the verifier finds of an undisturbed run."""

    def prepare(self, folder):
        return VirtualBench(folder)

    def do(self, bench):
        end = bench.begin()
        assert not end.why or str(bench.folder) in end.why, end.why
        assert list(end.unsafe) == []
        if self.usual is None:
            self.usual = bench.faults()
            assert {fault.kind for fault in self.usual} <= {"results", "journal"}, self.usual

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


class Authorisation:
    """A person's signature beside the seal of a run: whole or not there."""

    name = "authorisation"

    def prepare(self, folder):
        lab = SealedBench(new(folder))
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
        return SealedBench(new(folder))

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
    """A change of keys: the bench has one key that is trusted, also for a run that began before; it can be changed again."""

    name = "keys"

    def prepare(self, folder):
        lab = SealedBench(new(folder))
        lab.key = load_key(lab.home)
        return lab

    def do(self, lab):
        rotate(lab.home, NOW, passphrase=None, keep_old=True)

    def check(self, lab, end):
        later, end_of_all = NOW + timedelta(hours=1), NOW + timedelta(days=1)
        old, own = lab.key, usable_key(lab.home, later)
        assert key_to_seal(lab.home, old, later).public_key == own.public_key
        see_that_the_seal_holds(lab)
        if own.public_key == old.public_key:
            assert end.status
            rotate(lab.home, later, passphrase=None, keep_old=True)
        require_usable(lab.home, load_key(lab.home), end_of_all)
        assert not (lab.home / "bench_key.new").exists()
        assert len(list((lab.home / "old_keys").iterdir())) == 1
        listed = read_signers(lab.home / SIGNERS_FILE)
        assert [bool(signer.rejection(NAMESPACE, end_of_all)) for signer in listed] == [True, False]


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
    rig.write_boards(folder)
    rig.write_stars(folder / "stars")
    write_queue(folder / "queue.yaml", "name: one, sequence: three_pose, station: simulated")
    (folder / "draft.json").write_bytes(sealed_bytes(Passport.of_radius(255.0, 0.05)))


def once(module, name):
    """Let a function be calculated once, and return that ever after: it writes nothing."""
    real, known = getattr(import_module(module), name), {}

    def call(*words, **more):
        if not known:
            known[0] = real(*words, **more)
        return known[0]

    return mock.patch(f"{module}.{name}", call)


SIZE_OPTION = "--image-size 640x480"
COMMANDS = {
    "target": "target -s simulated -o {out}.svg",
    "station new": "station new {out} --no-questions",
    "station new --stand-ins": "station new {out} --stand-ins keysight",
    "passport make": f"passport make {{in}}/stars {SIZE_OPTION} -o {{out}}",
    "passport show --seal": "passport show {in}/draft.json --seal {out}",
    "calibrate": f"calibrate {{in}}/stars {SIZE_OPTION} -o {{out}}",
    "rehearse": "rehearse {in}/queue.yaml --begin 2026-03-01T19:30 -o {out}",
}
GOING_ON = {"calibrate --each": f"calibrate {{in}}/stars --each {SIZE_OPTION} -o {{out}}"}
OTHERS = {"run": Run, "authorisation": Authorisation, "ledger": Entries, "keys": Keys}


def patches():
    """What would take seconds a try, and writes nothing."""
    return [
        once("bench.solve.offline", "calibrate_paths"),
        once("bench.work.recalculation", "calibrate_found"),
        mock.patch("bench.commands.calibrate.open_workers", return_value=Serial()),
        once("bench.solve.offline_folder", "shown_files"),
        once("bench.stations.practice", "draft_stand_ins"),
    ]


def works_of(commands, going_on, others, inputs):
    """Works by their names."""
    works = {name: Command(name, words, inputs) for name, words in commands.items()}
    works |= {name: Command(name, words, inputs, goes_on=True) for name, words in going_on.items()}
    return works | {name: kind() for name, kind in others.items()}


def try_works(folder, steps, works):
    """Let the calls of works fail, every so many of each by name; tell how many of each kind, and return what fell."""
    fallen = []
    for name, (first, step) in steps.items():
        work = works[name]
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


def main_of(commands, going_on, others, patched, prepare=lambda _inputs: None):
    """Do what the command line of such a program asks: a folder, and first call and step of each work by name."""
    cv2.setNumThreads(1)
    folder = Path(sys.argv[1])
    os.environ["STARBENCH_HOME"] = str(folder / "home")
    inputs, steps = new(folder / "inputs"), json.loads(sys.argv[2])
    if any("{in}" in (commands | going_on).get(name, "") for name in steps):
        write_inputs(inputs)
        prepare(inputs)
    for patch in patched:
        patch.start()
    works = works_of(commands, going_on, others, inputs)
    sys.exit(bool(try_works(folder, steps, works)))


if __name__ == "__main__":
    main_of(COMMANDS, GOING_ON, OTHERS, patches())
