"""The page about how Starbench is built: every file, name, level, event and state on it exists."""

import re
import tomllib
from pathlib import Path

import pytest

from bench.record.events import Event
from bench.run.machine import STATES

ROOT = Path(__file__).parents[3]
DOCUMENT = ROOT / "docs" / "architecture.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
    "contracts"
]
MODULE_LINK = re.compile(r"\[`([\w./-]+)`\]\(\.\./([\w./-]+)\)")


def section(title):
    return TEXT.partition(f"\n## {title}")[2].partition("\n## ")[0]


def rows(text):
    return [line.strip("| ").split(" | ") for line in text.splitlines() if re.match(r"\| [^-]", line)][1:]


def names_in(text):
    return re.findall(r"`([A-Za-z_][\w.]*)`", text)


def named_modules():
    """Each linked module with the names that the page says are in it."""
    for line in TEXT.splitlines():
        links = list(MODULE_LINK.finditer(line))
        ends = [*(link.start() for link in links[1:]), len(line)][: len(links)]
        for link, end in zip(links, ends, strict=True):
            after = line[link.end() : end]
            if after.startswith(": "):  # `module`: `Name`, `Name`
                yield link[2], names_in(re.match(r": (?:`[\w.]+`(?:, )?)+", after)[0])


def test_a_linked_file_is_called_as_it_is_shown():
    links = MODULE_LINK.findall(TEXT)
    assert len(links) > 40
    assert [shown for shown, path in links if shown.rstrip("/") != path] == []


@pytest.mark.parametrize(("path", "names"), [*named_modules()], ids=str)
def test_a_name_is_in_the_module_that_the_page_says(path, names):
    code = (ROOT / path).read_text(encoding="utf-8")
    assert names
    assert [n for n in names if not re.search(rf"^(?:class |def |)({n})\b", code, re.MULTILINE)] == []


def test_the_spine_is_numbered_and_has_the_main_name_of_each_module():
    spine = rows(section("The spine: 16 modules"))
    assert [row[0] for row in spine] == [str(number) for number in range(1, 17)]
    for _, module, what in spine:
        code = (ROOT / MODULE_LINK.search(module)[2]).read_text(encoding="utf-8")
        names = names_in(what.rpartition("(")[2])
        assert names
        assert [n for n in names if not re.search(rf"^(?:class |def |)({n})\b", code, re.MULTILINE)] == []


@pytest.mark.parametrize(("package", "heading"), [("bench", "**Levels of"), ("calib", "**Rooms of")])
def test_levels_are_those_of_the_contract(package, heading):
    contract = next(c for c in CONTRACTS if c["type"] == "layers" and c["containers"] == [package])
    table = TEXT.partition(heading)[2].partition("\n\n|")[2].partition("\n\n")[0]
    shown = [set(names_in(row[0])) for row in rows("|" + table)]
    assert shown == [set(layer.split(" | ")) for layer in contract["layers"]]


def test_events_and_states_of_the_run_exist():
    known = {str(event) for event in Event} | set(STATES) | {"left", "right", "below"}
    for journal, _ in rows(section("One run, step by step")):
        assert set(names_in(journal)) <= known, journal


def test_functions_that_are_called_in_the_run_exist():
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "bench").rglob("*.py"))
    code += (ROOT / "drivers" / "stage" / "__init__.py").read_text(encoding="utf-8")
    for name in names_in(section("One run, step by step")):
        if "." not in name:
            continue
        cls, _, method = name.partition(".")
        if cls[0].isupper():
            assert re.search(rf"^class {cls}\b", code, re.MULTILINE), name
            assert re.search(rf"^    def {method}\b", code, re.MULTILINE), name
