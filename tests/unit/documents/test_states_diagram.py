"""The diagram of the states in the documents is the one of the machine."""

from pathlib import Path

from states_diagram import diagram

PAGE = Path(__file__).parents[3] / "docs" / "architecture.md"


def test_the_diagram_of_the_states_is_drawn_from_the_machine():
    shown = PAGE.read_text(encoding="utf-8").split("```mermaid\n", 1)[1].split("\n```", 1)[0]
    assert shown == diagram(), "docs/architecture.md is not current: python tests/support/states_diagram.py"
