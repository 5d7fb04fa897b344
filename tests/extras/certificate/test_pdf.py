"""The certificate as PDF: the same bytes, text as data, every number and text, characters that fonts do not have."""

import dataclasses
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from sealed_bench import RESULTS, sample_results

from bench.base.errors import BenchError, UsageError
from bench.extras.certificate import pdf
from bench.extras.certificate.certificate_data import Covariance, Deviation, Statement
from bench.extras.certificate.pdf import PLOTS, draw_plots, pictures, render_pdf
from bench.measure.view_picture import ViewPicture
from tests.extras.support.certificate_sample import FAILED, full_certificate, small_certificate
from tests.support.printed_numbers import missing_numbers, missing_texts, numbers_of, texts_of

pytest.importorskip("typst", reason="typst is not installed (extra certificate)")
from tests.extras.support.printed_content import opening_of, sections_of

ATTACHED = {"dcc.xml": b"<dcc/>\r\n", "results.json": RESULTS.read_bytes()}
NO_PLOTS = {}
HOSTILE = '#panic(1) <script>alert(1)</script> $x^2$ *b* _i_ `c` \\ "q" @ref <l> // c /* d */ #sys.version'


def changed(certificate, **fields):
    return dataclasses.replace(certificate, **fields)


def customer_named(name):
    full = full_certificate()
    return changed(full, customer=full.customer.model_copy(update={"name": name}))


def words(certificate):
    """All text of the document."""
    whole = [opening_of(certificate), sections_of(certificate, ATTACHED)]
    return "\n".join([certificate.title, f"END OF CERTIFICATE {certificate.number}", *texts_of(whole)])


# ---------------------------------------------------------------- same input, same bytes


@pytest.mark.slow
def test_another_process_with_another_clock_place_and_language_makes_the_same_bytes(tmp_path):
    code = (
        "import sys, hashlib; sys.path[:0] = sys.argv[1:]\n"
        "from tests.extras.certificate.test_pdf import *\n"
        "print(hashlib.sha256(render_pdf(full_certificate(), sample_results(), ATTACHED)).hexdigest())"
    )
    root = RESULTS.parents[2]
    places = [root, root / "tests/support", root / "tests/extras/support"]
    command = [sys.executable, "-c", code, *map(str, places)]
    other = os.environ | {"TZ": "Pacific/Chatham", "LANG": "tr_TR.UTF-8", "SOURCE_DATE_EPOCH": "1"}
    other |= {"PYTHONHASHSEED": "7", "HOME": str(tmp_path), "MPLCONFIGDIR": str(tmp_path)}
    first, second = (
        subprocess.run(command, env=env, cwd=tmp_path, capture_output=True, check=True)
        for env in (dict(os.environ), other)
    )
    assert first.stdout == second.stdout


# ---------------------------------------------------------------- the annex stands behind


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="no poppler on this computer")
@pytest.mark.parametrize("certificate", [full_certificate(), small_certificate()], ids=["full", "small"])
def test_four_pages_say_what_the_certificate_says(certificate):
    data = render_pdf(certificate, sample_results(), ATTACHED)
    read = subprocess.run(["pdftotext", "-", "-"], input=data, capture_output=True, check=True)
    pages = read.stdout.decode().split("\f")
    (annex,) = [at for at, text in enumerate(pages) if re.search(r"^Annex$", text, re.MULTILINE)]
    assert annex <= 4
    assert "Verdicts" in pages[0]
    assert "Authorised by" in "".join(pages[:annex])
    assert "Uncertainty budgets" in pages[annex]


def test_budgets_and_covariance_are_the_annex():
    sections = sections_of(full_certificate(), ATTACHED)
    titles = {section["title"]: section["annex"] for section in sections}
    budgets, covariance, *_ = [title for title, annex in titles.items() if annex]
    assert budgets == "Uncertainty budgets"
    assert covariance.startswith("Covariance")


def test_the_variance_of_one_value_is_no_matrix():
    full = full_certificate()
    single = changed(full, covariance=Covariance(("fx",), ("px",), ((1.0,),)))
    assert "Covariance" not in " ".join(part["title"] for part in sections_of(single, ATTACHED))


# ---------------------------------------------------------------- every value is printed


@pytest.mark.parametrize("certificate", [full_certificate(), small_certificate()], ids=["full", "small"])
def test_numbers_and_texts_are_printed(certificate):
    printed = words(certificate)
    assert missing_numbers(certificate, printed) == []
    assert missing_texts(certificate, printed) == []


def test_a_large_covariance_is_printed_in_parts():
    names = tuple(f"k{number}" for number in range(19))
    matrix = tuple(tuple(1e-9 * min(i, j) + 0.1234567 * (i == j) for j in range(19)) for i in range(19))
    large = changed(full_certificate(), covariance=Covariance(names, ("1",) * 19, matrix))
    sections = sections_of(large, {})
    (section,) = (section for section in sections if section["title"].startswith("Covariance"))
    parts = [part for block in section["blocks"] for part in block.get("blocks", [])]
    tables = [part for part in parts if part["kind"] == "table"]
    assert [len(table["head"]) for table in tables] == [8, 8, 6] * 2  # about as many columns in each
    shown = numbers_of("\n".join(texts_of(tables)))
    for row in matrix:
        for value in row:
            assert any(abs(value - printed) <= half for printed, half, _ in shown)


# ---------------------------------------------------------------- what an assessor looks for


def test_simulated_and_amended_stand_before_the_results_and_a_real_one_says_neither():
    opening = " ".join(texts_of(opening_of(full_certificate())))
    small = words(small_certificate())
    for text in ("SIMULATED", "replaces certificate SIMULATED-SB-2026-00016"):
        assert text in opening
    assert not re.search("SIMULATED|replaces", small)
    assert not re.search(r"\bdue\b|recalibrat|valid until", small, re.IGNORECASE)


def test_the_verdicts_of_earlier_runs_stand_before_the_results():
    assert FAILED in " ".join(texts_of(opening_of(full_certificate())))


def test_the_state_is_printed_with_the_person_and_the_key():
    text = "until authorised by Dr. Grace Hopper, Head of laboratory (key SHA256:"
    assert text in " ".join(texts_of(opening_of(small_certificate())))


def test_each_attached_file_is_listed_with_its_hash():
    text = words(full_certificate())
    for name, data in ATTACHED.items():
        assert name in text
        assert hashlib.sha256(data).hexdigest() in text


# ---------------------------------------------------------------- text is data


def test_markup_of_typst_and_html_is_text():
    hostile = changed(
        customer_named(HOSTILE), opinions=(HOSTILE, "W" * 400, "line\nline", "", ']]#eval("1")')
    )
    assert render_pdf(hostile, {}, ATTACHED, NO_PLOTS)
    assert HOSTILE in words(hostile)


# ---------------------------------------------------------------- characters


def test_scripts_that_are_printed():
    text = "Łódź Ünïcode Ελλάδα Москва Հայաստան საქართველო עברית العربية Việt ½ ± µ °C ″ ∞ ⁻⁵ ᵢ"
    assert pdf.missing(text) == []
    assert render_pdf(customer_named(text), {}, {}, NO_PLOTS)


@pytest.mark.parametrize(
    "text",
    ["山田光学", "株式会社", "한국", "ไทย", "भारत", "\u202e001", "a\x07b", "\ue000", "\ufeff", "😀"],
)
def test_characters_without_a_font_that_the_laboratory_wrote_are_refused(text):
    with pytest.raises(UsageError) as caught:
        render_pdf(customer_named(text), {}, {}, NO_PLOTS)
    assert "customer.name" in str(caught.value)
    assert all(f"U+{ord(character):04X}" in str(caught.value) for character in pdf.missing(text))


def test_all_fields_that_the_laboratory_states_are_named_at_once():
    stated = changed(customer_named("山"), opinions=("田",), deviations=(Deviation("山", "laboratory"),))
    fields = r"(?s)customer\.name has 山.*deviations\[0\]\.text.*opinions\[0\] has 田"
    with pytest.raises(UsageError, match=fields):
        render_pdf(stated, {}, {}, NO_PLOTS)


def test_what_the_run_holds_is_printed_as_code_with_a_note():
    noted = changed(full_certificate(), deviations=(Deviation("pose 山\u202e was skipped", "run"),))
    assert render_pdf(noted, {}, {}, NO_PLOTS)
    assert "pose [U+5C71][U+202E] was skipped" in words(noted)
    assert pdf.CODE_NOTE in words(noted)
    assert pdf.CODE_NOTE not in words(full_certificate())


@pytest.mark.parametrize(
    ("kind", "refused"), [("traceability", True), ("also", True), ("not_included", False)]
)
def test_a_statement_is_refused_if_the_laboratory_words_it(kind, refused):
    stated = changed(full_certificate(), statements=(Statement(kind, "山"),))
    assert bool(pdf.faults(json.loads(stated.to_json()))) == refused


# ---------------------------------------------------------------- plots


def test_plots_that_follow_from_the_results_alone():
    assert set(draw_plots(sample_results())) == {"uncertainty", "distortion"}


def test_plots_with_the_stars_of_the_poses():
    import numpy as np

    points = np.random.default_rng(1).uniform((0, 0), (1279, 719), (80, 2))
    views = [ViewPicture("pose", None, points, points + 0.1, np.arange(80))]
    plots = draw_plots(sample_results(), views)
    assert set(plots) == {"uncertainty", "coverage", "vectors", "regions", "distortion"}
    shown = pictures(full_certificate(), plots)
    assert [plot["name"] for plot in shown] == [name for name in PLOTS if name in plots]
    assert all("0.46 px" in plot["alt"] and "boresight" not in plot["alt"] for plot in shown)
    assert render_pdf(full_certificate(), {}, {}, plots)


def test_without_a_covariance_there_are_no_plots():
    calibration = {**sample_results()["calibration"], "covariance": None}
    assert draw_plots({"calibration": calibration}) == {}


# ---------------------------------------------------------------- faults


def test_a_fault_of_the_layout_is_one_message(monkeypatch):
    monkeypatch.setattr(pdf, "document", lambda *_: {})
    with pytest.raises(BenchError, match="typst"):
        render_pdf(small_certificate(), {}, {}, NO_PLOTS)
