"""A certificate as PDF, read by programs that nobody here wrote: poppler, qpdf, pikepdf, OpenSSH.

Each test is skipped where its program is missing; the reason names it.
"""

import dataclasses
import hashlib
import re
import shutil
import subprocess
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from sealed_bench import RESULTS, sample_results

from bench.extras.certificate.pdf import draw_plots, render_pdf
from bench.measure.view_picture import ViewPicture
from tests.extras.support.certificate_sample import full_certificate, small_certificate
from tests.support.printed_numbers import missing_numbers, missing_texts

pytest.importorskip("typst", reason="typst is not installed (extra certificate)")

ATTACHED = {
    "dcc.xml": b"<?xml version='1.0'?>\r\n<dcc>\xc3\xa4</dcc>",
    "results.json": RESULTS.read_bytes(),
    "wire.bin": bytes(range(256)),
}
PDFAID = "{http://www.aiim.org/pdfa/ns/id/}"
PDFUAID = "{http://www.aiim.org/pdfua/ns/id/}"


def program(name):
    if not (path := shutil.which(name)):
        pytest.skip(f"{name} is not installed")
    return path


def output_of(*command, **more):
    """What a program prints; it must end with status 0."""
    done = subprocess.run(
        [program(command[0]), *map(str, command[1:])], capture_output=True, check=False, timeout=60, **more
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


@pytest.fixture(scope="module")
def plots():
    random = np.random.default_rng(1)
    views = []
    for number in range(25):
        points = random.uniform((0, 0), (1279, 719), (200, 2))
        shifted = points + random.normal(0, 0.06, points.shape)
        views.append(ViewPicture(f"pose-{number:02d}", None, points, shifted, np.arange(len(points))))
    return draw_plots(sample_results(), views)


@pytest.fixture(scope="module")
def full(tmp_path_factory, plots):
    """The full certificate, simulated and amended, with plots of 25 poses."""
    path = tmp_path_factory.mktemp("full") / "certificate.pdf"
    path.write_bytes(render_pdf(full_certificate(), sample_results(), ATTACHED, plots))
    return path


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "certificate.pdf"
    path.write_bytes(render_pdf(small_certificate(), sample_results(), {"dcc.xml": ATTACHED["dcc.xml"]}))
    return path


def pages(path):
    return output_of("pdftotext", "-raw", path, "-").removesuffix("\f").split("\f")


def running_text(path):
    """The text of all pages; what stands at the head or the foot of each stands there once, at the end."""
    lines = [[re.sub(r"page \d+ of \d+$", "", line) for line in page.splitlines()] for page in pages(path)]
    repeated = set.intersection(*map(set, lines))
    return "\n".join([*(line for page in lines for line in page if line not in repeated), *repeated])


# ---------------------------------------------------------------- poppler


@pytest.mark.parametrize("name", ["full", "small"])
def test_poppler_shows_every_number_and_text(name, request):
    certificate = full_certificate() if name == "full" else small_certificate()
    text = running_text(request.getfixturevalue(name))
    assert missing_numbers(certificate, text) == []
    assert missing_texts(certificate, text) == []


@pytest.mark.parametrize("name", ["full", "small"])
def test_each_page_has_number_and_page_of_pages(name, request):
    all_pages = pages(request.getfixturevalue(name))
    number = (full_certificate() if name == "full" else small_certificate()).number
    for at, page in enumerate(all_pages, 1):
        assert f"page {at} of {len(all_pages)}" in page
        assert f"Certificate {number}" in page
        assert ("SIMULATED" in page) == (name == "full")
        assert (f"END OF CERTIFICATE {number}" in page) == (at == len(all_pages))


def test_attached_files_come_out_with_the_same_bytes(full, tmp_path):
    output_of("pdfdetach", "-saveall", "-o", tmp_path, full)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == ATTACHED


def test_every_font_is_embedded(full):
    rows = output_of("pdffonts", full).splitlines()[2:]
    assert rows
    for row in rows:
        embedded, subset, unicode = row.split()[-5:-2]
        assert (embedded, subset, unicode) == ("yes", "yes", "yes"), row
        assert re.search("LibertinusSerif|DejaVuSansMono", row)


def test_title_language_dates_and_no_script(full):
    shown = output_of("pdfinfo", full)
    assert re.search(r"Title: +SIMULATED .*SIMULATED-SB-2026-00017\n", shown)
    assert re.search(r"JavaScript: +no\n", shown)
    assert re.search(r"Tagged: +yes\n", shown)
    assert re.search(r"Encrypted: +no\n", shown)
    assert "2026" in re.search(r"CreationDate: +(.*)\n", shown)[1]


# ---------------------------------------------------------------- qpdf


@pytest.mark.parametrize("name", ["full", "small"])
def test_qpdf_finds_nothing_wrong(name, request):
    assert "errors found" in output_of("qpdf", "--check", request.getfixturevalue(name))


# ---------------------------------------------------------------- pikepdf


@pytest.fixture
def opened(full):
    pikepdf = pytest.importorskip("pikepdf", reason="pikepdf is not installed")
    with pikepdf.open(full) as pdf:
        yield pdf


def test_it_claims_pdf_a_3a_and_pdf_ua_1(opened):
    tree = ET.fromstring(opened.Root.Metadata.read_bytes())
    assert [element.text for element in tree.iter(f"{PDFAID}part")] == ["3"]
    assert [element.text for element in tree.iter(f"{PDFAID}conformance")] == ["A"]
    assert [element.text for element in tree.iter(f"{PDFUAID}part")] == ["1"]


def test_every_figure_has_a_description(opened):
    tree = elements(opened.Root.StructTreeRoot)
    figures = [element for element in tree if element.get("/S") == "/Figure"]
    assert len(figures) == 5
    assert all(len(str(element.get("/Alt", ""))) > 40 for element in figures)


def test_attached_files_are_associated_with_the_document(opened):
    relations = {str(attached.UF): str(attached.AFRelationship) for attached in opened.Root.AF}
    assert relations == {"dcc.xml": "/Alternative", "results.json": "/Source", "wire.bin": "/Supplement"}
    assert {str(attached.EF.F.Subtype) for attached in opened.Root.AF} == {
        "/application/xml",
        "/application/json",
        "/application/octet-stream",
    }


def elements(root):
    """Each element of the tree of tags; numbers among the kids are content, not elements."""
    import pikepdf

    kids = root.get("/K", [])
    for kid in [kids] if isinstance(kids, pikepdf.Dictionary | int) else kids:
        if not isinstance(kid, int) and "/S" in kid:
            yield kid
            yield from elements(kid)


# ---------------------------------------------------------------- OpenSSH


def test_the_printed_commands_verify_the_certificate(small, tmp_path):
    program("ssh-keygen"), program("sha256sum")
    (tmp_path / "certificate.pdf").write_bytes(small.read_bytes())
    listed = f"{hashlib.sha256(small.read_bytes()).hexdigest()}  certificate.pdf\n"
    (tmp_path / "SHA256SUMS").write_text(listed)
    signers = []
    for name, namespace, signed in (
        ("bench@lab", "starbench-report@v1", "SHA256SUMS"),
        ("grace.hopper", "starbench-authorisation@v1", "SHA256SUMS.sig"),
    ):
        output_of("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", tmp_path / name)
        output_of("ssh-keygen", "-q", "-Y", "sign", "-f", tmp_path / name, "-n", namespace, tmp_path / signed)
        signers.append(f'{name} namespaces="{namespace}" {(tmp_path / f"{name}.pub").read_text()}')
    (tmp_path / "SHA256SUMS.sig.sig").rename(tmp_path / "SHA256SUMS.authorised.sig")
    (tmp_path / "allowed_signers").write_text("".join(signers))
    text = "\n".join(pages(small))
    commands = re.findall(
        r"^(?:ssh-keygen -Y verify|sha256sum --strict)[^<]*?(?:< [\w.]+|SHA256SUMS)$", text, re.MULTILINE
    )
    assert len(commands) == 3
    answers = [output_of("sh", "-c", command, cwd=tmp_path) for command in commands]
    assert "bench@lab" in answers[0]
    assert answers[1] == "certificate.pdf: OK\n"
    assert "grace.hopper" in answers[2]


# ---------------------------------------------------------------- long texts


def test_no_word_is_lost_and_none_leaves_the_paper(tmp_path):
    """Texts longer than a page, in places that otherwise stay on one page."""
    full, said_words = full_certificate(), []

    def long(tag):
        said_words.extend(f"{tag}{number}" for number in range(900))
        return " ".join(said_words[-900:])

    certificate = dataclasses.replace(
        full,
        item=dataclasses.replace(full.item, condition=long("condition")),
        customer=full.customer.model_copy(update={"name": "N" * 2000}),
        amends=dataclasses.replace(full.amends, reason=long("reason")),
        method=full.method.model_copy(update={"text": long("method")}),
        conformity=(dataclasses.replace(full.conformity[0], specification=long("specification")),),
        authorised_by=full.authorised_by.model_copy(update={"role": long("role")}),
        opinions=(long("opinion"),),
        conditions=full.conditions * 30,
    )
    path = tmp_path / "certificate.pdf"
    path.write_bytes(render_pdf(certificate, {}, {}, {}))
    assert set(said_words) <= set(re.split(r"[\s,]+", "\n".join(pages(path))))
    boxes = re.findall(
        r'xMin="(\S+)" yMin="(\S+)" xMax="(\S+)" yMax="(\S+)"', output_of("pdftotext", "-bbox", path, "-")
    )
    at = np.array(boxes, float)
    assert len(at) > len(said_words)
    assert (at[:, :2] >= 0).all()
    assert (at[:, 2] <= 595.3).all()
    assert (at[:, 3] <= 841.9).all()
