"""A sealed run that somebody with the bench's own key has changed and sealed again: each change is found.

Each row names what a stock program shows of it. `ssh-keygen` and `sha256sum` accept every resealed folder, because seal
and list are right; so ``-`` means that no stock program shows it, and the other entries name what a patient person
could compare by hand.
"""

import contextlib
import io
import json
import os
import random
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import h5py
import pytest
from click.testing import CliRunner
from quick_runs import write_sequence, write_station

from bench.base.clock import BenchClock
from bench.base.home import HOME_VARIABLE
from bench.commands.cli import cli
from bench.commands.evidence_output import show_verification
from bench.evidence.keys import AUTHORISATION_NAMESPACE, create_key, load_key
from bench.evidence.signers import Signer, read_signers
from bench.evidence.sshsig import sign
from bench.evidence.verify import verify_folder
from bench.plan.job import Job
from bench.report import figures
from bench.results import reproduce
from bench.results.derive_again import check_run
from bench.results.derive_views import RunViews
from bench.run.launch import Launch, start_run
from tests.unit.bench.evidence.resealed import Forger, kinds

POSES = (
    "[{name: left, pan_deg: -6, tilt_deg: 2}, {name: right, pan_deg: 6, tilt_deg: 2},"
    " {name: below, pan_deg: 0, tilt_deg: -3}]"
)
CERTIFICATE = (
    "nominal_r_mm: 255, certificate: {number: C-7, r_mm: 255, uncertainty_mm: 0.1, date: 2026-01-12}}"
)
CAPTURE = "captures/pose-00%d-attempt-1.raw"


@pytest.fixture(scope="module", autouse=True)
def drawn_once():
    """Plots of the same results and stars are drawn once: it takes a second."""
    draw, drawn = figures.report_plots, {}

    def report_plots(results, views):
        stars = b"".join(view.detected.tobytes() + view.residuals.tobytes() for view in views)
        key = json.dumps(results), stars
        if key not in drawn:
            drawn[key] = draw(results, views)
        return drawn[key]

    with mock.patch("bench.report.figures.report_plots", report_plots):
        yield


@pytest.fixture(scope="module")
def bench_home(tmp_path_factory):
    return tmp_path_factory.mktemp("bench")


@pytest.fixture(scope="module")
def run_once(tmp_path_factory, bench_home):
    """A sealed run of a simulated bench, not to be touched."""
    folder = tmp_path_factory.mktemp("attacked")
    station = write_station(folder / "station.yaml")
    text = station.read_text()
    assert "nominal_r_mm: 255}" in text
    station.write_text(text.replace("nominal_r_mm: 255}", CERTIFICATE))
    sequence = write_sequence(folder / "sequence.yaml", POSES, attempts=1)
    launch = Launch(BenchClock(), stream=io.StringIO())
    with mock.patch.dict(os.environ, {HOME_VARIABLE: str(bench_home)}):
        end = start_run(
            str(sequence), str(station), output=folder / "run", seed=1, operator="Ada", launch=launch
        )
    assert end.how == "finished", end.why
    return folder / "run"


@pytest.fixture(scope="module")
def bench_key(run_once, bench_home):
    return load_key(bench_home)


@pytest.fixture(scope="module")
def trusted(run_once, bench_home):
    return read_signers(bench_home / "allowed_signers")


@pytest.fixture(scope="module")
def job(run_once):
    return Job.from_run_folder(run_once, seed=1, operator="Ada")


def copied(folder, to):
    shutil.copytree(folder, to)
    for path in [to, *to.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return to


@pytest.fixture
def forger(run_once, bench_key, tmp_path):
    return Forger(copied(run_once, tmp_path / "run"), bench_key)


# ------------------------------------------------------------------ what is changed


def edit(name, old, new):
    return lambda f: f.replace(name, old, new)


def write(name, data):
    def attack(f):
        (f / name).parent.mkdir(exist_ok=True)
        (f / name).write_bytes(data)

    return attack


def remove(*names):
    return lambda f: [(f / name).unlink() for name in names]


def told(*attacks):
    """The attacks, and then every hash in the journal is put right."""

    def attack(f):
        for one in attacks:
            one(f)
        f.tell_of_files()

    return attack


def result(*path, to):
    """Set a value of results.json, and put every hash in the journal right."""

    def change(results):
        part = results
        for key in path[:-1]:
            part = part[key]
        assert part[path[-1]] != to
        part[path[-1]] = to

    return told(lambda f: f.edit_results(change))


def line(event, change, nth=0):
    return told(lambda f: f.edit_line(event, change, nth=nth))


def drop(*events):
    return told(lambda f: f.edit_journal(lambda one: None if one[0] in events else one))


def both(*path, key, to, event):
    """Set a value in the journal and in results.json alike."""

    def attack(f):
        f.edit_line(event, lambda data: data.__setitem__(key, to))
        result(*path, to=to)(f)

    return attack


def shifted_clock(f):
    """An hour less between the recordings: the run seems to have been quicker, or at another time."""

    def change(one):
        seq, hour = len(seen), one[1][11:13]
        seen.append(one)
        return (
            one
            if seq < 20
            else [one[0], one[1].replace(f"T{hour}:", f"T{(int(hour) + 1) % 24:02d}:"), *one[2:]]
        )

    seen = []
    f.edit_journal(change)
    f.tell_of_files()


def without_pose(f):
    """The third pose never happened: not in the journal, not in the results, no recording."""
    (f / (CAPTURE % 3)).unlink()
    f.edit_journal(lambda one: None if one[3].get("pose") == 3 else one)
    f.edit_results(lambda results: results["poses"].pop())
    f.tell_of_files()


def without_results(f):
    """No results were ever written: a result that was not liked disappears."""
    remove("results.json", "views.h5", "report.html")(f)
    shutil.rmtree(f / "exports")
    (f / "exports").mkdir()

    def change(one):
        is_report = one[0] == "written" or one[3].get("state") == "reporting"
        return None if is_report else one

    f.edit_journal(change)
    last = max(one[3]["step"] for one in f.lines if one[0] == "step_done")
    f.edit_journal(lambda one: None if one[0] == "step_done" and one[3]["step"] == last else one)


def other_serial(f):
    """Another camera, in the journal, the facts of each recording and the results; not in the files' heads."""
    for _ in range(1):
        lines = f.lines
        for event, _, _, data in lines:
            if event == "devices":
                data["camera"]["serial"] = "00050999"
            if event == "capture_stored":
                data["facts"]["serial"] = "00050999"
        f.chain(lines)
    result("devices", "camera", "serial", to="00050999")(f)


def other_stage(f):
    f.edit_line("devices", lambda data: data["stage"][0].__setitem__("serial", "999999"))
    f.edit_results(lambda results: results["devices"]["stage"][0].__setitem__("serial", "999999"))
    f.tell_of_files()


def not_simulated(f):
    """The station with real ports; everything says that the run was real."""
    text = "".join(
        line
        for line in (f / "station.yaml").read_text().splitlines(True)
        if not line.startswith("simulation:")
    )
    for old, new in (
        ("sim:gimbal", "/dev/ttyUSB0"),
        ("sim:light", "/dev/ttyUSB1"),
        ("simulated_evk4", "metavision"),
        ("  address: sim:camera\n", ""),
    ):
        assert old in text
        text = text.replace(old, new)
    (f / "station.yaml").write_text(text)
    f.edit_line("run_started", lambda data: data.__setitem__("simulated", False))
    f.edit_results(lambda results: results["run"].__setitem__("simulated", False))
    f.tell_of_files()


def in_views(change):
    def attack(f):
        with h5py.File(f / "views.h5", "r+") as file:
            change(file)
        f.tell_of_files()

    return attack


def move_star(file):
    points = file["pose-001/points_px"][()]
    points[0] += 0.3
    file["pose-001/points_px"][...] = points


def paint(f):
    """An image is painted over, and views.h5 written as the program writes it."""
    held = RunViews.read(f / "views.h5")
    painted = held.pictures[0]()
    painted[100:140, 100:140] = 255
    f.write_views(replace(held, pictures=[lambda: painted, *held.pictures[1:]]))
    f.tell_of_files()


def swap_captures(f):
    one, two = (f / (CAPTURE % n) for n in (1, 2))
    data = one.read_bytes(), two.read_bytes()
    one.write_bytes(data[1])
    two.write_bytes(data[0])
    in_results(f)


def in_results(f):
    """Put the hashes of the recordings into results.json too."""
    f.tell_of_files()
    sums = {one[3]["capture"]: one[3]["sha256"] for one in f.lines if one[0] == "capture_stored"}

    def change(results):
        for pose in results["poses"]:
            for attempt in pose["attempts"]:
                attempt["sha256"] = sums[attempt["capture"]]

    f.edit_results(change)
    f.tell_of_files()


def half_wire(f):
    data = (f / "wire.jsonl").read_bytes()
    (f / "wire.jsonl").write_bytes(data[: data.index(b"\n", len(data) // 3) + 1])
    f.tell_of_files()


def other_truth(f):
    f.edit_results(
        lambda results: results["truth"]["camera"].__setitem__("fx", results["calibration"]["camera"]["fx"])
    )
    f.tell_of_files()


def forged_focal_length(f, job):
    """fx is 2 px longer in every file that states it; plots, exports and hashes follow."""

    def change(results):
        results["calibration"]["camera"]["fx"] += 2.0
        for row in results["comparison"]:
            if row["name"] == "fx":
                row["value"] += 2.0
                row["error"] = row["value"] - row["truth"]
                row["error_sigmas"] = row["error"] / row["sigma"]

    f.edit_results(change)
    fx = f.results["calibration"]["camera"]["fx"]
    f.edit_line("solved", lambda data: data["values"].__setitem__("fx", fx))
    rederive(f, job)


def rederive(f, job):
    """Put right what follows from the calibration, as the program does."""
    from bench.results.comparison import compare_with_truth
    from bench.results.results_content import projection
    from bench.results.stored_calibration import stored_calibration
    from bench.views.views_file import read_views

    results = f.results
    calibration = stored_calibration(results["calibration"])
    views = [stored.view for stored in read_views(f / "views.h5")]
    f.edit_results(lambda r: r.update(projection=projection(calibration, views)))
    f.edit_results(lambda r: r.update(comparison=compare_with_truth(calibration, r["truth"])))
    f.render(job)
    f.tell_of_files()


@dataclass(frozen=True)
class Attack:
    """One attack: its name, what it does, where it is found, and what a stock program shows."""

    name: str
    do: object
    where: str
    kind: str
    stock: str = "-"


HASH = "sha256sum FILE against the first line of journal.jsonl"
WRITTEN = "sha256sum FILE against the line `written` of journal.jsonl"
CHAIN = "the hashes of journal.jsonl by sed and sha256sum"
DIFF = "reading results.json beside journal.jsonl"

ATTACKS = [
    # documents
    Attack("station edited", edit("station.yaml", "laboratory: ", "laboratory: Other "), "station.yaml", "plan", HASH),
    Attack("station edited, told", told(edit("station.yaml", "laboratory: ", "laboratory: Other ")), "results.json", "results", DIFF),
    Attack("station's name, told", told(edit("station.yaml", "name: ", "name: My ")), "journal.jsonl:1", "journal", DIFF),
    Attack("biases of the station, told", told(edit("station.yaml", "speed_deg_s: 90", "speed_deg_s: 45")), "plan.json", "plan"),
    Attack("sequence edited", edit("sequence.yaml", "Quick poses", "Other poses"), "sequence.yaml", "plan", HASH),
    Attack("settling time, told", told(edit("sequence.yaml", "duration_s: 0.3", "duration_s: 3.0")), "plan.json", "plan"),
    Attack("pose added to the sequence, told", told(edit("sequence.yaml", "tilt_deg: -3}", "tilt_deg: -3}, {name: more, pan_deg: 1}")), "journal.jsonl", "journal"),
    Attack("passport edited", edit("passport.json", "255", "256"), "passport.json", "plan", HASH),
    Attack("passport edited, told", told(edit("passport.json", "255", "256")), "results.json", "results", DIFF),
    Attack("passport removed", remove("passport.json"), "passport.json", "plan", HASH),
    Attack("passport removed, told", told(remove("passport.json")), "station.yaml", "plan"),
    Attack("plan edited", edit("plan.json", '"duration_s"', '"Duration_s"'), "plan.json", "plan", HASH),
    Attack("plan edited, told", told(edit("plan.json", '"size_bytes": ', '"size_bytes": 1')), "plan.json", "plan"),
    Attack("plan removed", remove("plan.json"), "plan.json", "plan", HASH),
    Attack("instructions that trust any key", edit("VERIFY.txt", "-Y verify -f allowed_signers -I", "-Y check-novalidate -I"), "VERIFY.txt", "instructions"),
    Attack("instructions with another key", edit("VERIFY.txt", "SHA256:", "SHA256:x"), "VERIFY.txt", "instructions", "ssh-keygen -lf"),
    # journal
    Attack("journal edited", edit("journal.jsonl", '"operator":"Ada"', '"operator":"Eve"'), "journal.jsonl:1", "journal", CHAIN),
    Attack("operator in the journal", line("run_started", lambda d: d.update(operator="Eve")), "results.json", "results", DIFF),
    Attack("seed in the journal", line("run_started", lambda d: d.update(seed=2)), "results.json", "results", DIFF),
    Attack("not simulated, in the journal", line("run_started", lambda d: d.update(simulated=False)), "journal.jsonl:1", "journal", DIFF),
    Attack("software in the journal", line("run_started", lambda d: d["software"].update(starbench="9.9")), "results.json", "results", DIFF),
    Attack("number in the ledger", line("run_started", lambda d: d["ledger"].update(number=7)), "results.json", "results", DIFF),
    Attack("camera in the journal", line("devices", lambda d: d["camera"].update(serial="00050999")), "results.json", "results", DIFF),
    Attack("biases in the journal", line("devices", lambda d: d["camera_settings"]["biases"].update(bias_fo=9)), "results.json", "results", DIFF),
    Attack("gates emptied in the journal", line("attempt_checked", lambda d: d.update(gates=[])), "results.json", "results", DIFF),
    Attack("verdict of a gate", line("attempt_checked", lambda d: d["gates"][1].update(verdict="fail")), "results.json", "results", DIFF),
    Attack("angle of a pose", line("capture_stored", lambda d: d["measured_deg"].update(pan=-6.1)), "results.json", "results", DIFF),
    Attack("numbers of the journal's calibration", line("solved", lambda d: d["values"].update(fx=1670.0)), "results.json", "results", DIFF),
    Attack("first line removed", drop("run_started"), "journal.jsonl:1", "journal", "head -n 1 journal.jsonl"),
    Attack("last line removed", drop("run_ended"), "journal.jsonl", "journal", "tail -n 1 journal.jsonl"),
    Attack("run not finished", line("run_ended", lambda d: d.update(how="aborted")), "journal.jsonl", "journal", "tail -n 1 journal.jsonl"),
    Attack("hashes of the results removed", drop("written"), "journal.jsonl", "journal"),
    Attack("clock moved within the run", shifted_clock, "journal.jsonl:21", "journal"),
    Attack("a pose never happened", without_pose, "journal.jsonl", "journal"),
    Attack("devices never named", drop("devices"), "results.json", "results", DIFF),
    Attack("a second begin", told(lambda f: f.chain([*f.lines[:5], f.lines[0], *f.lines[5:]])), "journal.jsonl:6", "journal"),
    # results
    Attack("results edited", edit("results.json", '"operator": "Ada"', '"operator": "Eve"'), "results.json", "results", WRITTEN),
    Attack("focal length", result("calibration", "camera", "fx", to=1675.0), "results.json", "results", DIFF),
    Attack("standard uncertainty", result("calibration", "sigma", "fx", to=0.01), "results.json", "results", DIFF),
    Attack("covariance", result("calibration", "covariance", "matrix", 0, 0, to=1e-4), "results.json", "results"),
    Attack("rms of the residuals", result("calibration", "rms_px", to=0.01), "results.json", "results", DIFF),
    Attack("rms of a view", result("calibration", "views", 0, "rms_px", to=0.01), "results.json", "results"),
    Attack("results without the journal's recordings", result("poses", 1, "attempts", to=[]), "results.json", "results", DIFF),
    Attack("simulated -> false", result("run", "simulated", to=False), "results.json", "results", DIFF),
    Attack("camera serial", result("devices", "camera", "serial", to="00050999"), "results.json", "results", DIFF),
    Attack("software version", result("run", "software", "starbench", to="9.9"), "results.json", "results", DIFF),
    Attack("form of the report", result("run", "software", "report_form", to="0" * 16), "results.json", "results", DIFF),
    Attack("seed", result("run", "seed", to=5), "results.json", "results", DIFF),
    Attack("operator", result("run", "operator", to="Eve"), "results.json", "results", DIFF),
    Attack("laboratory", result("run", "laboratory", to="Other lab"), "results.json", "results"),
    Attack("ledger number", result("run", "ledger", "number", to=7), "results.json", "results", DIFF),
    Attack("end of the run", result("run", "finished_utc", to="2026-01-01T00:00:00.000000Z"), "results.json", "results", DIFF),
    Attack("biases", result("conditions", "camera", "biases", "bias_fo", to=9), "results.json", "results", DIFF),
    Attack("temperature", result("conditions", "camera", "temperature_c", to=20.0), "results.json", "results", DIFF),
    Attack("gates emptied", result("gates", to=[]), "results.json", "results", DIFF),
    Attack("deviation invented", result("deviations", to=["none"]), "results.json", "results", DIFF),
    Attack("stars of a pose", result("poses", 0, "stars", to=999), "results.json", "results"),
    Attack("projection", result("projection", "worst_corner", "expanded_px", to=0.01), "results.json", "results"),
    Attack("error against the truth", result("comparison", 0, "error", to=0.0), "results.json", "results"),
    Attack("passport's hash", result("passport", "sha256", to="0" * 64), "results.json", "results", "sha256sum passport.json"),
    Attack("an approval that nobody gave", told(lambda f: f.edit_results(lambda r: r.update(approved_by="QA"))), "results.json", "results"),
    Attack("results removed", remove("results.json"), "results.json", "results", "ls"),
    Attack("results never written", without_results, "journal.jsonl", "journal"),
    Attack("results that are no results", told(write("results.json", b"[]\n")), "results.json", "results", "jq"),
    # views
    Attack("views replaced", write("views.h5", b"x" * 1000), "views.h5", "views", WRITTEN),
    Attack("views replaced, told", told(write("views.h5", b"x" * 1000)), "views.h5", "views", "h5ls"),
    Attack("residual of a star", in_views(lambda h: h["pose-001/residuals_px"].__setitem__(0, (9.0, 9.0))), "views.h5", "views"),
    Attack("hidden data in the views", in_views(lambda h: h.create_dataset("secret", data=[1])), "views.h5", "views", "h5ls"),
    Attack("hidden data in a pose", in_views(lambda h: h["pose-001"].create_dataset("secret", data=[1])), "views.h5", "views", "h5ls -r"),
    Attack("hidden bytes after the views", told(lambda f: f.replace("views.h5", (f / "views.h5").read_bytes(), (f / "views.h5").read_bytes() + b"x")), "views.h5", "views"),
    Attack("name of a pose in the views", in_views(lambda h: h["pose-001"].attrs.__setitem__("name", "x")), "views.h5", "views", "h5dump"),
    # exports
    *(
        Attack(f"export {name}", told(edit(f"exports/{name}", "167", "168")), f"exports/{name}", "exports", DIFF)
        for name in ("colmap_cameras.txt", "kalibr_camchain.yaml", "metavision.json", "mrcal.cameramodel", "opencv.yaml", "ros_camera_info.yaml")
    ),
    Attack("export, not told", edit("exports/opencv.yaml", "167", "168"), "exports/opencv.yaml", "exports", WRITTEN),
    Attack("export removed, told", told(remove("exports/opencv.yaml")), "exports/opencv.yaml", "exports", "ls"),
    Attack("export added", write("exports/more.yaml", b"fx: 1\n"), "exports/more.yaml", "exports", WRITTEN),
    Attack("export added, told", told(write("exports/more.yaml", b"fx: 1\n")), "exports/more.yaml", "exports"),
    # report
    Attack("report, not told", edit("report.html", "Calibration report", "Calibration Report"), "report.html", "report", WRITTEN),
    Attack("number in the report", told(edit("report.html", '<td class="n value">1', '<td class="n value">2')), "report.html", "report", DIFF),
    Attack("number by CSS", told(edit("report.html", "</style>", "td.value::before{content:'9'}</style>")), "report.html", "report"),
    Attack("number in a plot", told(edit("report.html", "</text>", "9</text>")), "report.html", "report"),
    Attack("number over a plot", told(edit("report.html", '<svg class="plot"', '<svg class="plot" style="opacity:0"')), "report.html", "report"),
    Attack("image in the report", told(edit("report.html", "base64,iVBORw0KGgo", "base64,iVBORw0KGgp")), "report.html", "report"),
    Attack("hidden attribute", told(edit("report.html", "<main>", '<main title="approved">')), "report.html", "report"),
    Attack("comment in the report", told(edit("report.html", "<main>", "<main><!-- approved -->")), "report.html", "report"),
    Attack("script in the report", told(edit("report.html", "</body>", "<script>1</script></body>")), "report.html", "report"),
    Attack("report empty", told(write("report.html", b"")), "report.html", "report"),
    # recordings
    Attack("recording exchanged", write(CAPTURE % 2, b"% end\n"), CAPTURE % 2, "recording", CHAIN),
    Attack("recording removed", remove(CAPTURE % 2), CAPTURE % 2, "recording", "ls"),
    Attack("recording added", write("captures/pose-004-attempt-1.raw", b"% end\n"), "captures/pose-004-attempt-1.raw", "recording", "grep capture_stored journal.jsonl"),
    Attack("another camera, everywhere but in the files", other_serial, CAPTURE % 1, "recording", "strings captures/*.raw"),
    # wires
    Attack("wire log emptied", write("wire.jsonl", b""), "wire.jsonl", "wire", "ls -l"),
    Attack("wire log emptied, told", told(write("wire.jsonl", b"")), "wire.jsonl", "wire", "ls -l"),
    Attack("wire log removed, told", told(remove("wire.jsonl")), "wire.jsonl", "wire", "ls -l"),
    Attack("wire log cut, told", half_wire, "wire.jsonl", "wire"),
    Attack("wire log of nothing", told(write("wire.jsonl", b"nothing\n")), "wire.jsonl", "wire", "jq"),
    Attack("wire edited", edit("wire.jsonl", "100101", "100109"), "wire.jsonl", "wire", WRITTEN),
    Attack("another stage, everywhere but on the wire", other_stage, "wire.jsonl", "wire", "grep wire.jsonl"),
    Attack("real ports, not simulated", not_simulated, "wire.jsonl", "wire", "grep wire.jsonl"),
    # kind and seal
    Attack("a run without its journal", remove("journal.jsonl"), "journal.jsonl", "kind", "ls"),
    Attack("a run as a certificate", write("certificate.json", b"{}\n"), "certificate.json", "kind", "ls"),
    Attack("a run as recalculated results", lambda f: [remove("journal.jsonl")(f), write("sources.json", b'{"sources": []}\n')(f)], "results.json", "results"),
]  # fmt: skip


def checked(folder, trusted, **more):
    from bench.results.derive_again import check_results_folder

    return verify_folder(
        folder, trusted, derivations={"run": [check_run], "results": [check_results_folder]}, **more
    )


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_a_resealed_change_is_found(forger, trusted, attack):
    attack.do(forger)
    forger.seal()
    found = checked(forger.folder, trusted)
    assert not {"signature", "key", "changed", "added", "missing"} & {fault.kind for fault in found.faults}
    assert (attack.kind, attack.where) in kinds(found), [str(fault) for fault in found.faults]


def test_there_are_many_attacks():
    assert len(ATTACKS) >= 45
    assert len({attack.name for attack in ATTACKS}) == len(ATTACKS)
    assert sum(attack.stock == "-" for attack in ATTACKS) >= 20


# ------------------------------------------------------------------ only the recordings tell


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


# ------------------------------------------------------------------ files beside the seal

BESIDE = {
    "SHA256SUMS.tsr": ("timestamp", b"garbage"),
    "SHA256SUMS.authorised.tsr": ("timestamp", b"garbage"),
    "SHA256SUMS.authorised.sig": ("authorisation", b"garbage"),
}


@pytest.mark.parametrize("name", BESIDE)
def test_a_reserved_file_that_does_not_hold_is_a_fault(forger, trusted, name):
    kind, data = BESIDE[name]
    (forger / name).write_bytes(data)
    found = checked(forger.folder, trusted)
    assert {fault.kind for fault in found.faults} == {kind}
    assert found.state == "SEALED"


def test_the_bench_cannot_authorise_itself(forger, trusted, bench_key):
    seal = (forger / "SHA256SUMS.sig").read_bytes()
    signature = sign(bench_key.private, seal, AUTHORISATION_NAMESPACE)
    (forger / "SHA256SUMS.authorised.sig").write_bytes(signature)
    found = checked(forger.folder, trusted)
    assert kinds(found) == [("authorisation", "SHA256SUMS.authorised.sig")]
    assert found.state == "SEALED"


# ------------------------------------------------------------------ what must stay valid


def unchanged(folder):
    return folder


def renamed(folder):
    return folder.rename(folder.with_name("another name, with ü"))


def older(folder):
    for path in folder.rglob("*"):
        os.utime(path, (0, 0))
    return folder


def read_only(folder):
    for path in [*folder.rglob("*"), folder]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    return folder


def other_modes(folder):
    for path in folder.rglob("*"):
        path.chmod(0o700 if path.is_dir() else 0o600)
    return folder


def linked(folder):
    link = folder.with_name("link")
    link.symlink_to(folder)
    return link


@pytest.mark.parametrize(
    "change", [unchanged, renamed, older, read_only, other_modes, linked], ids=lambda c: c.__name__
)
def test_what_happens_to_any_archive_leaves_it_valid(run_once, trusted, tmp_path, change):
    folder = change(copied(run_once, tmp_path / "run"))
    found = checked(folder, trusted)
    assert (found.faults, found.not_compared) == ((), ())


def test_a_relative_path_leaves_it_valid(run_once, trusted, monkeypatch):
    monkeypatch.chdir(run_once.parent)
    assert checked(Path("run"), trusted).complete


def test_an_authorised_run_is_valid_and_names_the_person(forger, trusted, tmp_path):
    person = create_key(tmp_path / "ada", principal="ada@lab.example")
    public = read_signers(tmp_path / "ada" / "allowed_signers")[0].public_key
    seal = (forger / "SHA256SUMS.sig").read_bytes()
    signature = sign(person.private, seal, AUTHORISATION_NAMESPACE)
    (forger / "SHA256SUMS.authorised.sig").write_bytes(signature)
    ada = Signer("ada@lab.example", public, (AUTHORISATION_NAMESPACE,))
    found = checked(forger.folder, [*trusted, ada])
    assert found.complete
    assert (found.state, found.person) == ("AUTHORISED", "ada@lab.example")
    assert kinds(checked(forger.folder, trusted)) == [("authorisation", "SHA256SUMS.authorised.sig")]


# ------------------------------------------------------------------ another version of the program


def by_another_program(f, **software):
    """Everything states another program, consistently."""
    f.edit_line("run_started", lambda data: data["software"].update(software))
    f.edit_results(lambda results: results["run"]["software"].update(software))
    f.tell_of_files()


def with_a_plugin(f):
    """Journal and results state a plug-in that this computer does not have."""
    f.edit_line("run_started", lambda d: d.update(plugins={"starbench-turntable": ["stage turntable"]}))
    f.edit_results(lambda r: r["run"].update(plugins={"starbench-turntable": ["stage turntable"]}))
    by_another_program(f, **{"starbench-turntable": "1.0"})


def test_a_run_on_a_plugin_that_is_not_here_is_not_compared_and_no_fault(forger, trusted):
    with_a_plugin(forger)
    station = (forger / "station.yaml").read_text().replace("driver: zaber_ascii", "driver: turntable")
    (forger / "station.yaml").write_text(station)
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.faults == ()
    (what,) = found.not_compared
    assert "the station needs starbench-turntable 1.0, which this computer does not have" in what


def test_a_plugin_that_the_station_does_not_use_is_found(forger, trusted):
    with_a_plugin(forger)
    forger.seal()
    found = checked(forger.folder, trusted)
    assert "journal.jsonl:1" in {fault.where for fault in found.faults}
    assert "the stage turntable was driven by a plug-in: starbench-turntable 1.0" in found.remarks


def test_another_program_that_writes_the_same_bytes_is_compared(forger, trusted, job):
    by_another_program(forger, program="0" * 16)
    forger.render(job)
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.complete
    assert any("program 0000000000000000 (here " in remark for remark in found.remarks)


def test_a_report_of_another_form_is_not_compared_and_the_folder_not_plainly_valid(forger, trusted):
    by_another_program(forger, report_form="0" * 16)
    forger.replace("report.html", "Calibration report", "Report of a calibration")
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.ok
    assert not found.complete
    assert [what for what in found.not_compared if what.startswith("report.html with results.json")]
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        assert show_verification(found, as_json=False) == 4
    assert "NOT COMPARED. Only the seal protects these parts" in shown.getvalue()


def test_another_program_does_not_excuse_what_both_state(forger, trusted):
    by_another_program(forger, program="0" * 16, starbench="9.9")
    result("devices", "camera", "serial", to="00050999")(forger)
    forger.seal()
    assert ("results", "results.json") in kinds(checked(forger.folder, trusted))


def test_another_opencv_leaves_the_words_compared(forger, trusted, job):
    by_another_program(forger, **{"opencv-python-headless": "1.0"})
    forger.render(job)
    forger.replace("report.html", "</text>", "9</text>")
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.ok
    assert [what for what in found.not_compared if what.startswith("plots and images of report.html")]
    forger.replace("report.html", "Calibration report", "Report of a calibration")
    forger.tell_of_files()
    forger.seal()
    assert ("report", "report.html") in kinds(checked(forger.folder, trusted))


# ------------------------------------------------------------------ stock programs


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")
def test_stock_programs_accept_what_was_resealed(forger, trusted, bench_home):
    """The list and its signature are right again, so ssh-keygen and sha256sum cannot tell."""
    edit("results.json", '"operator": "Ada"', '"operator": "Eve"')(forger)
    forger.seal()
    signers = bench_home / "allowed_signers"
    commands = [
        (
            f"ssh-keygen -Y verify -f {signers} -I {trusted[0].principal} -n starbench-report@v1"
            " -s SHA256SUMS.sig < SHA256SUMS"
        ),
        "sha256sum --strict --quiet -c SHA256SUMS",
    ]
    for command in commands:
        done = subprocess.run(["sh", "-c", command], cwd=forger.folder, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
    assert not checked(forger.folder, trusted).ok


# ------------------------------------------------------------------ any number


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


# ------------------------------------------------------------------ the command


def told_by_command(folder, home, *words):
    with mock.patch.dict(os.environ, {HOME_VARIABLE: str(home)}):
        return CliRunner().invoke(cli, ["verify", str(folder), *words], standalone_mode=False)


def test_the_command_says_first_what_the_folder_is_worth(run_once, bench_home):
    said = told_by_command(run_once, bench_home)
    assert said.return_value == 0, said.output
    assert said.stdout.startswith("SEALED: ")
    assert "by the bench's own clock" in said.stdout.splitlines()[1]
    assert "SIMULATED" in said.stdout


def test_the_command_lists_every_fault_and_ends_with_1(forger, bench_home):
    edit("results.json", '"operator": "Ada"', '"operator": "Eve"')(forger)
    forger.seal()
    said = told_by_command(forger.folder, bench_home)
    assert said.return_value == 1
    assert said.stderr.startswith("NOT VERIFIED:")
    assert "results.json: run.operator is" not in said.stderr  # the journal's hash comes first
    assert "results.json: by the journal, it is another file than the one that was written" in said.stderr


def test_the_command_ends_with_4_if_a_part_was_not_compared(forger, bench_home, tmp_path):
    by_another_program(forger, report_form="0" * 16)
    forger.replace("report.html", "Calibration report", "Report of a calibration")
    forger.tell_of_files()
    forger.seal()
    signers = str(bench_home / "allowed_signers")
    said = told_by_command(forger.folder, bench_home, "--json")
    assert said.return_value == 1  # the ledger of the bench holds the hash of the first seal
    assert {fault["kind"] for fault in json.loads(said.stdout)["faults"]} == {"ledger"}
    said = told_by_command(forger.folder, tmp_path / "elsewhere", "--allowed-signers", signers, "--json")
    assert said.return_value == 4
    found = json.loads(said.stdout)
    assert (found["ok"], found["complete"]) == (True, False)
    assert found["not_compared"][0].startswith("report.html with results.json: it was made with report form")


def test_a_ledger_that_was_set_back_is_found_with_the_run(run_once, bench_home, tmp_path):
    home = tmp_path / "home"
    shutil.copytree(bench_home, home)
    (home / "ledger.jsonl").write_bytes(b"")
    said = told_by_command(run_once, home)
    assert said.return_value == 1
    assert "its ledger does not contain it" in said.stderr


def test_another_bench_has_no_ledger_for_the_run_and_that_is_no_fault(run_once, bench_home, tmp_path):
    create_key(tmp_path / "elsewhere", principal="other@lab.example")
    signers = str(bench_home / "allowed_signers")
    said = told_by_command(run_once, tmp_path / "elsewhere", "--allowed-signers", signers)
    assert said.return_value == 0, said.output
    assert "no ledger confirms its number" in said.stdout
