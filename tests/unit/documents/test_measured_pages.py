"""The pages of measured tables: each table says where it comes from, and a benchmark replaces its own table only."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "docs" / "measured"
PAGES = sorted(path for path in FOLDER.glob("*.md") if path.stem != "README")
ORIGIN = re.compile(
    r"^Measured by `(python (?:-m pytest -m slow )?(\S+)|starbench \w+)[^`]*`.*commit [0-9a-f]{8}.*\d{4}-\d\d-\d\d",
    re.MULTILINE,
)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_table_names_its_command_its_commit_and_its_date(page):
    _, *sections = re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert sections
    for section in sections:
        title = section.partition("\n")[0]
        origin = ORIGIN.search(section)
        assert origin, title
        assert origin[2] is None or (ROOT / origin[2]).exists(), title
        assert "|" in section[origin.end() :] or "```" in section[origin.end() :], title


def test_every_page_and_heading_that_a_benchmark_writes_exists():
    for program in (ROOT / "tests" / "benchmarks").glob("*.py"):
        for page, title in re.findall(
            r'measured\.run\(main, "(.+?)", "(.+?)"\)', program.read_text(encoding="utf-8")
        ):
            assert f"\n## {title}\n" in (FOLDER / f"{page}.md").read_text(encoding="utf-8"), program.name


def sentences_with_a_table():
    """Each sentence or row of a page that links to a measured table: the page, the sentence, the section it links to."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        if page.relative_to(ROOT / "docs").parts[0] in {"decisions", "measured"}:
            continue
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for sentence in re.split(r"\n\s*\n|\n(?=[*|-] )|(?<=[.:|]) (?=[A-Z*])", text):
            for name, title in re.findall(r"measured/([\w-]+)\.md(?:#([\w-]+))?\)", sentence):
                yield pytest.param(sentence, section(name, title), id=f"{page.stem}: {name} {title}")


def section(name, anchor):
    """The text below a heading of a measured page; the whole page without a heading."""
    text = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    for part in re.split(r"^## ", text, flags=re.MULTILINE):
        heading = part.partition("\n")[0].lower()
        if anchor and re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") == anchor:
            return part
    assert not anchor, f"{name}.md has no heading {anchor}"
    return text


FIGURE = re.compile(
    r"(?<![\w.,])(\d+\.\d+|\d[\d,]*(?= (?:px|%|s|ms|degrees|Gbit/s|Mev/s|mm|MB|GB|stars|runs)(?!\w)))(?!\w)"
)


@pytest.mark.parametrize(("sentence", "table"), [*sentences_with_a_table()])
def test_a_figure_beside_a_link_to_a_table_stands_in_that_table(sentence, table):
    """Rounded figures are those of the table, too: 0.014 for 0.0142."""
    numbers = [float(number.replace(",", "")) for number in re.findall(r"\d[\d,]*(?:\.\d+)?", table)]
    for figure in FIGURE.findall(sentence):
        digits = len(figure.partition(".")[2])
        shown = float(figure.replace(",", ""))
        assert any(abs(number - shown) <= 0.5 * 10**-digits for number in numbers), figure
