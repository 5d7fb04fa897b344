"""A report held against the results: every word, every mark of the page, every plot; and what cannot be compared."""

import copy
import shutil
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from report_sample import sample

from bench.again.files import MadeAgain, compare_files, maker_of
from bench.base.bounded_json import canonical_json
from bench.evidence.findings import Findings
from bench.measure.views_file import StoredView, views_file
from bench.record.stored_calibration import stored_calibration
from bench.report import plots
from bench.solve.result import shown_files
from bench.solve.results_content import software
from calib.target import StarTarget
from calib.view import View

HEAD = "ab" * 32
TARGET = StarTarget()


def held_views(results):
    """Stars and images for the sample's poses."""
    rng = np.random.default_rng(1)

    def held_view(name):
        points = rng.uniform(0, 150, (30, 2))
        view = View(name, (160, 90), np.arange(30), points, points / 10, np.tile(np.eye(2), (30, 1, 1)))
        picture = rng.integers(0, 255, (90, 160)).astype(np.uint8)
        return StoredView(view, rng.normal(0, 0.1, (30, 2)), lambda: picture)

    return [held_view(view["name"]) for view in results["calibration"]["views"]]


def write(folder, results, held):
    """Write results and what follows from them."""
    calibration = stored_calibration(results["calibration"])
    shown = shown_files(results, calibration, "camera", TARGET, held, HEAD)
    files = {"results.json": canonical_json(results), "views.h5": views_file(held), **shown}
    for name, data in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder of results, and what was made again; plots are drawn once."""
    results = copy.deepcopy(sample(size=(160, 90)).results)
    results["run"]["software"] = software()
    for view in results["calibration"]["views"]:
        view |= {"rotation": np.eye(3).tolist(), "centre_mm": [0.0, 0.0, -255.0]}
    held = held_views(results)
    drawn = plots.report_plots(results, [stored.shown() for stored in held])
    folder = tmp_path_factory.mktemp("made")
    with mock.patch("bench.report.plots.report_plots", return_value=drawn):
        write(folder, results, held)
        yield folder, results, held


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made[0], tmp_path / "results")


def compared(folder, made, **used):
    """Compare a folder; ``used`` is what results and journal state of the program."""
    results = copy.deepcopy(made[1])
    results["run"]["software"] |= used
    findings = Findings()
    made_again = MadeAgain(results, made[2], "camera", TARGET, HEAD)
    compare_files(folder, made_again, maker_of(results, results["run"]["software"]), findings)
    return findings


def edited(folder, name, old, new):
    data = (folder / name).read_bytes()
    assert old.encode() in data
    (folder / name).write_bytes(data.replace(old.encode(), new.encode(), 1))


def test_the_same_tree_is_confirmed(folder, made):
    findings = compared(folder, made)
    assert (findings.faults, findings.not_compared) == ([], [])
    assert any("last bit" in remark for remark in findings.remarks)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (">3346.4", ">3346.41"),
        ("</style>", "b{display:none}</style>"),
        ("<main>", "<main><!-- 1 -->"),
        ('href="data:image/png;base64,', 'href="data:image/png;base64,A'),
        (HEAD, "0" * 64),
    ],
)
def test_another_word_mark_or_plot_of_the_report_is_a_fault_with_its_place(folder, made, old, new):
    edited(folder, "report.html", old, new)
    (fault,) = compared(folder, made).faults
    assert (fault.kind, fault.where) == ("report", "report.html")
    assert "from byte " in fault.what
    assert "where results.json gives" in fault.what


@pytest.mark.parametrize(
    ("part", "name", "old", "what"),
    [
        ("report_form", "report.html", "<main>", "report.html with results.json: it was made with report form x (here "),
        ("numpy", "report.html", "</text>", "report.html with results.json: it was made with numpy x (here "),
        ("export_form", "exports/opencv.yaml", "camera_name", "exports/opencv.yaml with results.json: it was made with "),
    ],
)  # fmt: skip
def test_what_another_program_made_otherwise_is_not_compared_and_that_is_told(
    folder, made, part, name, old, what
):
    results = copy.deepcopy(made[1])
    results["run"]["software"][part] = "x"
    write(folder, results, made[2])
    edited(folder, name, old, f"{old} ")
    findings = compared(folder, made, **{part: "x"})
    assert findings.faults == []
    assert any(reason.startswith(what) for reason in findings.not_compared), findings.not_compared


def test_a_missing_and_an_added_export_are_faults(folder, made):
    (folder / "exports/opencv.yaml").unlink()
    (folder / "exports/more.yaml").write_text("fx: 1\n")
    assert {(fault.kind, fault.where) for fault in compared(folder, made).faults} == {
        ("exports", "exports/opencv.yaml"),
        ("exports", "exports/more.yaml"),
    }


@pytest.mark.parametrize(("sigmas", "is_told"), [(0.15, False), (0.25, True)])
def test_a_star_may_lie_a_tenth_of_its_u_beside(folder, made, sigmas, is_told):
    first, *others = made[2]
    sigma = np.sqrt(first.view.covariances_px2[0, 0, 0])
    points = first.view.points_px + np.array([sigmas * sigma, 0.0])
    (folder / "views.h5").write_bytes(
        views_file([replace(first, view=replace(first.view, points_px=points)), *others])
    )
    assert bool([fault for fault in compared(folder, made).faults if fault.kind == "views"]) == is_told


def test_if_results_are_wrong_nothing_is_said_of_what_follows_from_them(folder, made):
    results = copy.deepcopy(made[1])
    results["calibration"]["covariance"]["names"] = []
    (folder / "results.json").write_bytes(canonical_json(results))
    assert {fault.kind for fault in compared(folder, made).faults} == {"results"}
