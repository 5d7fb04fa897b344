"""The page of all commands is the one that the commands make."""

from pathlib import Path

from commands_page import page

PAGE = Path(__file__).parents[3] / "docs" / "commands.md"


def test_the_page_of_commands_is_current():
    assert PAGE.read_text(encoding="utf-8") == page(), (
        "docs/commands.md is not current: python tests/support/commands_page.py > docs/commands.md"
    )
