"""Changes that are consistent in all other files: only the recordings tell, by `verify --again`."""

import json
import random
from unittest import mock

import pytest

from bench.evidence.verify import verify_folder
from bench.results import reproduce
from bench.results.derive_again import check_run
from tests.unit.bench.evidence.attack_steps import (
    CAPTURE,
    checked,
    copied,
    forged_focal_length,
    in_views,
    move_star,
    other_truth,
    paint,
    rederive,
    swap_captures,
)
from tests.unit.bench.evidence.resealed import Forger

pytestmark = pytest.mark.usefixtures("drawn_once")


@pytest.fixture(scope="module")
def again_once(run_once):
    """`check_recordings`, which measures a recording only once, however often it is verified."""
    measure, solve = reproduce._measure, reproduce.solve_run
    measured, solved = {}, {}

    def key_of(folder):
        return tuple((folder / (CAPTURE % n)).read_bytes() for n in (1, 2, 3))

    def _measure(evidence, attempt):
        path = evidence.folder / attempt.stored["capture"]
        key = path.read_bytes(), attempt.pose_index
        if key not in measured:
            measured[key] = measure(evidence, attempt)
        return measured[key]

    def solve_run(job, folder, step, history, measurements):
        key = key_of(folder), (folder / "sequence.yaml").read_bytes(), json.dumps(dict(history.solved))
        if key not in solved:
            solved[key] = solve(job, folder, step, history, measurements)
        return solved[key]

    with mock.patch.multiple(reproduce, _measure=_measure, solve_run=solve_run):
        yield reproduce.check_recordings


def checked_again(folder, trusted, again):
    return verify_folder(folder, trusted, derivations={"run": [again]})


def test_the_untouched_run_is_valid_and_follows_from_its_recordings(run_once, trusted, again_once):
    found = verify_folder(run_once, trusted, derivations={"run": [check_run, again_once]})
    assert (found.faults, found.not_compared) == ((), ())
    assert found.complete
    assert found.state == "SEALED"
    assert any("equal to the last bit" in remark for remark in found.remarks)


QUICK = ("focal length in every file", "image painted over")
AGAIN = {
    "focal length in every file": (forged_focal_length, "results.json"),
    "stars moved in the views": (lambda f, job: [in_views(move_star)(f), rederive(f, job)], "views.h5"),
    "image painted over": (lambda f, job: [paint(f), rederive(f, job)], "views.h5"),
    "truth of the simulated world": (lambda f, job: [other_truth(f), rederive(f, job)], "results.json"),
    "planar comparison": (
        lambda f, job: [
            f.edit_results(lambda r: r["planar"].update(rms_px=0.01)),
            rederive(f, job),
        ],
        "results.json",
    ),
    "notes removed": (
        lambda f, job: [f.edit_results(lambda r: r["calibration"].update(notes=[])), rederive(f, job)],
        "results.json",
    ),
    "gate of a recording in journal and results": (
        lambda f, job: [
            f.edit_line("attempt_checked", lambda d: d["gates"][0].update(value=999)),
            f.edit_results(lambda r: r["gates"][0].update(value=999)),
            rederive(f, job),
        ],
        "journal.jsonl",
    ),
    "recordings exchanged, every hash put right": (
        lambda f, job: [swap_captures(f), rederive(f, job)],
        "journal.jsonl",
    ),
}


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in AGAIN]
)
def test_what_is_consistent_in_all_other_files_is_found_from_the_recordings(
    forger, trusted, job, again_once, name
):
    attack, where = AGAIN[name]
    attack(forger, job)
    forger.seal()
    assert (
        checked(forger.folder, trusted).faults == ()
    )  # whoever has key and program can write all of this again
    found = checked_again(forger.folder, trusted, again_once)
    assert where in {fault.where for fault in found.faults}, [str(fault) for fault in found.faults]


@pytest.mark.slow
def test_any_changed_digit_of_the_results_is_found(run_once, trusted, tmp_path, bench_key, again_once):
    """Any digit, with every hash put right; the recordings are asked for what the files alone do not show."""
    chance = random.Random(7)
    text = (run_once / "results.json").read_text()
    places = [at for at, sign_ in enumerate(text) if sign_.isdigit() and text[at - 1].isdigit()]
    for number, at in enumerate(chance.sample(places, 15)):
        forger = Forger(copied(run_once, tmp_path / str(number)), bench_key)
        changed = text[:at] + str((int(text[at]) + 5) % 10) + text[at + 1 :]
        (forger / "results.json").write_text(changed)
        forger.tell_of_files()
        forger.seal()
        found = checked(forger.folder, trusted)
        if found.ok:
            found = checked_again(forger.folder, trusted, again_once)
        told_of = found.faults or [remark for remark in found.remarks if "by rounding only" in remark]
        same = json.loads(changed) == json.loads(text)
        assert same or told_of, f"not found: {text[max(0, at - 60) : at + 20]!r}"


@pytest.mark.slow
def test_a_recording_without_stars_is_told_in_words(forger):
    (forger / (CAPTURE % 2)).write_bytes(b"% nothing\n")
    said = [str(fault) for fault in reproduce.check_recordings(forger.folder).faults]
    assert any("cannot be calibrated again" in one for one in said), said
