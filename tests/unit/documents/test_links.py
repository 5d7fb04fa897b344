"""Links between the documents: every file and every heading they lead to exists, and every document is listed."""

import re
from pathlib import Path

import pytest

from sequences.schema import StepConfig

ROOT = Path(__file__).parents[3]
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def anchors(path):
    """Anchors of the headings of a document, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def broken(path):
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in LINK.findall(text):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file).resolve() if file else path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            yield link


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path):
    assert list(broken(path)) == []


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_every_place_that_is_named_exists(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    named = re.findall(r"`((?:bench|calib|drivers|sequences|simulators|tests)/[\w/.-]+)`", text)
    assert len(named) > 10
    assert [place for place in named if not (ROOT / place).exists()] == []


def test_the_index_lists_every_document():
    listed = set(LINK.findall((ROOT / "docs" / "pages.md").read_text(encoding="utf-8")))
    documents = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    with_their_own_index = {name for name in documents if re.match(r"decisions/\d|measured/[a-z]", name)}
    assert documents - with_their_own_index - {"README.md", "pages.md"} <= listed


@pytest.mark.parametrize("folder", ["decisions", "measured"])
def test_the_index_of_a_folder_lists_every_page_of_it(folder):
    index = ROOT / "docs" / folder / "README.md"
    listed = set(LINK.findall(index.read_text(encoding="utf-8")))
    assert {path.name for path in index.parent.glob("*.md")} - {"README.md"} <= listed


def test_the_readme_names_every_step():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [name for name in StepConfig.model_fields if f"`{name}`" not in text] == []


def test_the_architecture_page_names_every_folder():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    folders = {path.name for path in ROOT.iterdir() if (path / "__init__.py").exists()}
    assert [name for name in folders if f"| [`{name}/`]" not in text] == []


def test_the_pages_have_at_most_46000_words():
    """Decisions and measured tables apart; who adds a page says on it what no other page says."""
    pages = [path for path in DOCUMENTS if path.is_relative_to(ROOT / "docs")]
    apart = {"decisions", "measured"}
    counted = [path for path in pages if path.relative_to(ROOT / "docs").parts[0] not in apart]
    assert sum(len(path.read_text(encoding="utf-8").split()) for path in counted) <= 46_000
