"""The states of a run and the edges between them as a diagram, drawn from the machine itself, for docs/architecture.md.

python tests/support/states_diagram.py
"""

from bench.run.machine import EDGES, END_STATES, READY, STATES

ANY = {*STATES} - {*END_STATES, "aborting"}


def diagram():
    """The diagram in Mermaid: the states from which the next step can begin form one block, ``ready``."""
    lines = ["stateDiagram-v2", "    [*] --> idle", "    state ready {"]
    lines += [*(f"        {name}" for name in READY), "    }"]
    for trigger, sources, target in EDGES:
        left = sources
        if {*sources} >= {*READY}:
            left = ("ready", *(name for name in sources if name not in READY))
        if {*sources} >= ANY:
            left = ("any", *(name for name in sources if name not in ANY))
        lines += [f"    {source} --> {target}: {trigger}" for source in left]
    return "\n".join([*lines, *(f"    {name} --> [*]" for name in END_STATES)])


if __name__ == "__main__":
    print(diagram())
