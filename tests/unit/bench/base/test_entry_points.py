"""A command of a stranger's package, as docs/plugins.md declares it."""

import re
import sys
import tomllib
from pathlib import Path

import pytest
from calling import out_of, refusal

from bench.base import entry_points as module
from bench.base.entry_points import COMMANDS, SCHEMAS, ExtraMissing, load

PAGE = (Path(__file__).parents[4] / "docs" / "plugins.md").read_text(encoding="utf-8")
PAGE = PAGE.partition("## A command of your own")[2]
BLOCKS = dict(re.findall(r"```(toml|python)\n(.*?)```", PAGE, re.DOTALL))


@pytest.fixture
def install(tmp_path, monkeypatch):
    """What installs a package of one module."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def installed(name, code, groups):
        (tmp_path / f"{name}.py").write_text(code)
        metadata = tmp_path / f"{name}-1.0.dist-info"
        metadata.mkdir()
        text = "".join(
            f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
            for group, entries in groups.items()
        )
        (metadata / "entry_points.txt").write_text(text)
        (metadata / "METADATA").write_text(f"Name: {name}\nVersion: 1.0\n")
        module.entry_points.cache_clear()

    yield installed
    module.entry_points.cache_clear()


def test_the_command_of_the_page_is_listed_without_an_import_and_works(install, capsys, tmp_path):
    install("starbench_fleet", BLOCKS["python"], tomllib.loads(BLOCKS["toml"])["project"]["entry-points"])
    many = out_of(capsys, "--help").partition("Many runs:")[2].partition("Without devices:")[0]
    assert re.search("^  fleet +Count the runs of a fleet.$", many, re.MULTILINE)
    assert "starbench_fleet" not in sys.modules
    assert out_of(capsys, "fleet", tmp_path) == "0 runs\n"
    sys.modules.pop("starbench_fleet")


def test_a_command_of_the_core_cannot_be_replaced(install, capsys):
    install("thief", "", {COMMANDS: {"keys | The bench | Steal.": "thief:keys"}})
    assert "Steal" not in out_of(capsys, "--help")
    assert "signing keys" in out_of(capsys, "keys", "--help")


def test_a_package_that_cannot_be_imported_is_named(install, capsys):
    install(
        "broken", "import not_there", {COMMANDS: {"broken": "broken:x"}, SCHEMAS: {"lost": "lost.model:x"}}
    )
    message = refusal(capsys, "broken", status=2)
    assert "broken 1.0" in message
    assert "not_there" in message
    assert "  broken" in out_of(capsys, "--help")
    with pytest.raises(ExtraMissing, match=r"needs the package lost\b"):
        load(SCHEMAS, "lost")


def test_an_error_of_an_installation_older_than_its_source_tells_what_it_lacks(tmp_path, monkeypatch, capsys):
    (tmp_path / "pyproject.toml").write_text(
        '[project.entry-points."starbench.schemas"]\nlabel = "x:y"\n'
        '[project.entry-points."starbench.event_files"]\nnewest = "x:y"\n'
        '[project.entry-points."starbench.commands"]\n"fresh | A run | Do." = "x:y"\n'
    )
    monkeypatch.setattr(module, "SOURCE", tmp_path)
    for words in (("schema", "label"), ("fresh",), ("convert", "none.raw", "a.npz")):
        message = refusal(capsys, *words, status=2)
        assert "label, newest, fresh" in message
        assert f"pip install --no-deps -e {tmp_path}" in message
