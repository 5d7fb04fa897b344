"""The diagram of the states in the documents is the one of the machine."""

import html
import re
from pathlib import Path

from states_diagram import PICTURE, arrows, diagram

PAGE = Path(__file__).parents[3] / "docs" / "architecture.md"


def test_the_diagram_of_the_states_is_drawn_from_the_machine():
    shown = PAGE.read_text(encoding="utf-8").split("```mermaid\n", 1)[1].split("\n```", 1)[0]
    assert shown == diagram(), "docs/architecture.md is not current: python tests/support/states_diagram.py"


def test_the_picture_of_the_site_has_the_same_arrows():
    titles = re.findall(r"<title>(.+?)</title>", PICTURE.read_text(encoding="utf-8"))
    drawn = {tuple(html.unescape(title).split("->")) for title in titles if "&gt;" in title}
    assert drawn == {(source, target) for source, target, _ in arrows()}, (
        "python tests/support/states_diagram.py --svg"
    )
