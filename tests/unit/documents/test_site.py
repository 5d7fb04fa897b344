"""The site of the documents: what its configuration makes of the pages of GitHub. `make docs` builds the whole."""

import importlib.util
import re
from pathlib import Path

import pytest

pytest.importorskip("latex2mathml", reason="the site needs: pip install 'starbench[docs]'")

DOCS = Path(__file__).parents[3] / "docs"
PARTS = ["Learn", "Do", "Look up", "Understand", "Decisions and measured tables"]


@pytest.fixture(scope="module")
def conf():
    spec = importlib.util.spec_from_file_location("site_configuration", DOCS / "conf.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def as_site(conf, page):
    source = [(DOCS / f"{page}.md").read_text(encoding="utf-8")]
    conf.as_site(None, page, source)
    return source[0]


def side_bars(text):
    return re.findall(r"```\{toctree\}\n:hidden:\n(?::caption: (.+)\n)?\n((?:\S+\n)+)```", text)


def test_the_front_page_has_a_side_bar_of_five_parts(conf):
    assert [caption for caption, _ in side_bars(as_site(conf, "README"))] == PARTS


def test_every_page_is_in_one_place_of_the_side_bars(conf):
    listed = []
    for index in ("README", "decisions/README", "measured/README"):
        folder = (DOCS / index).parent
        listed += [
            (folder / page).resolve()
            for _, pages in side_bars(as_site(conf, index))
            for page in pages.split()
        ]
    pages = {path for suffix in ("md", "rst") for path in DOCS.rglob(f"*.{suffix}")}
    assert sorted(listed) == sorted(pages - {DOCS / "README.md", DOCS / "pages.md"})


def test_a_link_to_a_file_outside_of_the_documents_is_shown_as_its_name(conf):
    text = as_site(conf, "architecture")
    assert "](../" not in text
    assert "`bench/run/machine.py`" in text
    assert "](plugins.md)" in text


def test_decisions_and_measured_tables_are_left_out_of_the_search(conf):
    assert as_site(conf, "decisions/0002-dependencies").startswith("---\nnosearch: true\n---\n")
    assert not as_site(conf, "boards").startswith("---")
