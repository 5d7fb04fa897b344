"""The states of a run and the edges between them as a diagram, drawn from the machine itself, for docs/architecture.md.

python tests/support/states_diagram.py           # the text for the page, which GitHub draws
python tests/support/states_diagram.py --svg     # docs/pictures/states.svg, for the site; needs graphviz
"""

import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from bench.run.machine import EDGES, END_STATES, READY, STATES

ANY = {*STATES} - {*END_STATES, "aborting"}
PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "states.svg"


def arrows():
    """The edges as source, target and trigger; ``ready`` and ``any`` stand for the states that they hold."""
    for trigger, sources, target in EDGES:
        left = sources
        if {*sources} >= {*READY}:
            left = ("ready", *(name for name in sources if name not in READY))
        if {*sources} >= ANY:
            left = ("any", *(name for name in sources if name not in ANY))
        yield from ((source, target, trigger) for source in left)


def diagram():
    """The diagram in Mermaid: the states from which the next step can begin form one block, ``ready``."""
    lines = ["stateDiagram-v2", "    [*] --> idle", "    state ready {"]
    lines += [*(f"        {name}" for name in READY), "    }"]
    lines += [f"    {source} --> {target}: {trigger}" for source, target, trigger in arrows()]
    return "\n".join([*lines, *(f"    {name} --> [*]" for name in END_STATES)])


def picture():
    """The diagram as SVG, drawn by graphviz."""
    triggers = defaultdict(list)
    for source, target, trigger in arrows():
        triggers[source, target].append(trigger)
    lines = [
        'digraph {rankdir=LR; bgcolor=white; node [shape=box, style="rounded,filled", fillcolor="#eef3f8"];'
    ]
    lines += [
        'ready [fillcolor="#d5e6d5", label="ready:\\n' + "\\n".join(READY) + '"]; any [fillcolor="#f5e6c8"];'
    ]
    lines += [f'{name} [fillcolor="#e8e8e8", peripheries=2];' for name in END_STATES]
    lines += [f'{s} -> {t} [label="{", ".join(names)}", fontsize=10];' for (s, t), names in triggers.items()]
    drawn = subprocess.run(
        ["dot", "-Tsvg"], input="\n".join([*lines, "}"]), text=True, check=True, stdout=subprocess.PIPE
    )
    return drawn.stdout


if __name__ == "__main__":
    if "--svg" in sys.argv:
        PICTURE.write_text(picture(), encoding="utf-8")
    else:
        print(diagram())
