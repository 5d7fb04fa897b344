"""Changes of a sealed run by somebody who has the bench's own key, and the verification that must find them."""

import shutil
from dataclasses import replace

import h5py

from bench.again.run import check_run_again
from bench.again.verdict import check_verdict
from bench.evidence.verify import verify_folder
from bench.measure.views_file import read_views
from calib.model.cause import Cause

CAPTURE = "captures/pose-00%d-attempt-1.raw"
SLEPT = Cause("computer stood still", 100.0, 60.0, unit="s").to_dict()


def checked(folder, trusted, *, again=True):
    """What `verify --again` finds without a ledger, or plain `verify`."""
    checks = [check_verdict, *([check_run_again] if again else [])]
    return verify_folder(folder, trusted, derivations=checks, again=again)


def edit(name, old, new):
    return lambda f: f.replace(name, old, new)


def write(name, data):
    def attack(f):
        (f / name).parent.mkdir(exist_ok=True)
        (f / name).write_bytes(data)

    return attack


def remove(*names):
    return lambda f: [(f / name).unlink() for name in names]


def with_hashes(*attacks):
    """The attacks, and then every hash in the journal is put right."""

    def attack(f):
        for attack_step in attacks:
            attack_step(f)
        f.tell_of_files()

    return attack


def set_at(tree, path, value):
    """Set another value in nested data, at the keys of a path."""
    for key in path[:-1]:
        tree = tree[key]
    assert tree[path[-1]] != value
    tree[path[-1]] = value


def result(*path, to):
    """Set a value of results.json, and put every hash in the journal right."""
    return with_hashes(lambda f: f.edit_results(lambda results: set_at(results, path, to)))


def line(event, change, nth=0):
    return with_hashes(lambda f: f.edit_line(event, change, nth=nth))


def drop(*events):
    return with_hashes(lambda f: f.edit_journal(lambda entry: None if entry[0] in events else entry))


def without_program(f):
    """As if a program had made the run that does not write the hashes of its results."""
    drop("written")(f)
    line("run_started", lambda d: d["software"].pop("program"))(f)


def shifted_clock(f):
    """An hour less between the recordings: the run seems to have been quicker, or at another time."""
    lines = f.lines
    for line in lines[20:]:
        hour = int(line[1][11:13])
        line[1] = line[1].replace(f"T{hour:02d}:", f"T{(hour + 1) % 24:02d}:")
    f.chain(lines)
    f.tell_of_files()


def without_pose(f):
    """The third pose never happened: not in the journal, not in the results, no recording."""
    (f / (CAPTURE % 3)).unlink()
    f.edit_journal(lambda entry: None if entry[3].get("pose") == 3 else entry)
    f.edit_results(lambda results: results["poses"].pop())
    f.tell_of_files()


def without_results(f):
    """No results were ever written: a result that was not liked disappears."""
    remove("results.json", "views.h5", "report.html")(f)
    shutil.rmtree(f / "exports")
    (f / "exports").mkdir()
    lines = [entry for entry in f.lines if entry[0] != "written" and entry[3].get("state") != "reporting"]
    last = max(entry[3]["step"] for entry in lines if entry[0] == "step_done")
    f.chain([entry for entry in lines if entry[0] != "step_done" or entry[3]["step"] != last])


def other_serial(f):
    """Another camera, in the journal, the facts of each recording and the results; not in the files' heads."""
    lines = f.lines
    for event, _, _, data in lines:
        if event == "devices":
            data["camera"]["serial"] = "00050999"
        if event == "capture_stored":
            data["facts"]["serial"] = "00050999"
    f.chain(lines)
    result("devices", "camera", "serial", to="00050999")(f)


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
    first, *others = read_views(f / "views.h5")
    painted = first.picture()
    painted[100:140, 100:140] = 255
    f.write_views([replace(first, picture=lambda: painted), *others])
    f.tell_of_files()


def swap_captures(f):
    first, two = (f / (CAPTURE % n) for n in (1, 2))
    data = first.read_bytes(), two.read_bytes()
    first.write_bytes(data[1])
    two.write_bytes(data[0])

    def with_its_size(line):
        if line[0] == "capture_stored":
            line[3]["facts"]["bytes"] = (f / line[3]["capture"]).stat().st_size
        return line

    f.edit_journal(with_its_size)
    in_results(f)


def in_results(f):
    """Put the hashes of the recordings into results.json too."""
    f.tell_of_files()
    sums = {entry[3]["capture"]: entry[3]["sha256"] for entry in f.lines if entry[0] == "capture_stored"}

    def change(results):
        for pose in results["poses"]:
            for attempt in pose["attempts"]:
                attempt["sha256"] = sums[attempt["capture"]]

    f.edit_results(change)
    f.tell_of_files()


def a_cause(f):
    """Journal and results name a computer that stood still, and the verdict follows."""
    f.edit_results(lambda results: results["causes"].append(SLEPT))
    f.edit_line("solved", lambda data: data["causes"].append(SLEPT))
    verdict = {"kind": "marginal", "headline": "Calibrated, with reservations."}
    line("written", lambda data: data.update(verdict=verdict))(f)


def other_truth(f):
    f.edit_results(
        lambda results: results["truth"]["camera"].__setitem__("fx", results["calibration"]["camera"]["fx"])
    )
    f.tell_of_files()


def forged_focal_length(f):
    """fx is 2 px longer in results and journal."""

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


def rederive(f, job):
    """Put right what follows from the calibration, as the program does."""
    from bench.base.bounded_json import canonical_json
    from bench.record.stored_calibration import stored_calibration
    from bench.record.stored_run import results_of
    from bench.solve.results_content import projection
    from bench.solve.solution import compare_with_truth

    results = results_of(canonical_json(f.results), f / "results.json")
    calibration = stored_calibration(results["calibration"])
    views = [stored.view for stored in read_views(f / "views.h5")]
    f.edit_results(lambda r: r.update(projection=projection(calibration, views)))
    f.edit_results(lambda r: r.update(comparison=compare_with_truth(calibration, r["truth"])))
    f.render(job)
    f.tell_of_files()


def by_another_program(f, **software):
    """Everything states another program, consistently."""
    f.edit_line("run_started", lambda data: data["software"].update(software))
    f.edit_results(lambda results: results["run"]["software"].update(software))
    f.tell_of_files()
