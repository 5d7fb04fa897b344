"""What `--help` says besides the options: commands in groups, an example of each, what the exit status means.

Knows the names of commands and nothing they do; `complete` gives a finished command line all of it.
"""

from __future__ import annotations

import click

SECTIONS = {
    "A run": ("plan", "run", "resume", "verify"),
    "While it runs, from another terminal": ("status", "hold", "release", "skip", "abort", "answer"),
    "Many runs": ("batch", "rehearse", "runs", "messages"),
    "Without devices": ("calibrate", "passport", "rig", "study", "convert"),
    "The bench": ("devices", "station", "simulate", "keys", "schema"),
}

EXAMPLES = {
    "run": (
        "starbench run three_pose --station simulated",
        "starbench run nine_pose -s my_bench.yaml -o runs/cam7 --operator 'A. Operator'",
        "starbench run three_pose -s simulated --set sequence.defaults.record.window_ms=50",
    ),
    "resume": ("starbench resume runs/cam7 --dry-run", "starbench resume runs/cam7"),
    "plan": (
        "starbench plan three_pose --station my_bench.yaml --suggest 3",
        "starbench plan night.yaml --begin 2026-03-01T21:00",
    ),
    "verify": (
        "starbench verify runs/cam7",
        "starbench verify runs/cam7 --serial 00051234 --allowed-signers lab_signers --again",
    ),
    "status": ("starbench status runs/cam7 --follow", "starbench status runs/night"),
    "hold": ("starbench hold runs/cam7",),
    "release": ("starbench release runs/cam7", "starbench release runs/cam7 --take-over"),
    "skip": ("starbench skip runs/cam7 --pose 4",),
    "abort": ("starbench abort runs/cam7",),
    "answer": ("starbench answer runs/cam7 yes",),
    "batch": ("starbench batch night.yaml --output runs/night", "starbench status runs/night --follow"),
    "batch run": ("starbench batch night.yaml --output runs/night",),
    "batch add": ("starbench batch add runs/night job.yaml",),
    "batch withdraw": ("starbench batch withdraw runs/night glass",),
    "batch summary": ("starbench batch summary runs/night",),
    "rehearse": ("starbench rehearse night.yaml --output runs/rehearsed --begin 2026-03-01T21:00",),
    "runs": (
        "starbench runs --serial 00051234 --since 2026-03-01 --compare",
        "starbench runs runs/night --how failed",
    ),
    "messages": ("starbench messages", "starbench messages --send"),
    "calibrate": (
        "starbench calibrate runs/cam7 --model auto --compare",
        "starbench calibrate runs/cam8 --passport collimator.json --views 1",
        "starbench calibrate points/*.csv --image-size 1280x720 --distortion k1k2k3",
    ),
    "passport": (
        "starbench passport make runs/* -o collimator.json",
        "starbench calibrate runs/cam8 --passport collimator.json",
    ),
    "passport make": ("starbench passport make runs/* -o collimator.json --collimator C-17 --model auto",),
    "passport certificate": (
        "starbench passport certificate --radius 255.02 --sigma 0.05 --number 2026-114 -o collimator.json",
    ),
    "passport show": ("starbench passport show collimator.json",),
    "rig": ("starbench rig runs/left runs/right",),
    "study": ("starbench study nine_pose --runs 500 --plot errors.svg",),
    "convert": ("starbench convert pose-001-attempt-1.raw pose.hdf5", "starbench convert pose.hdf5 pose.raw"),
    "devices": ("starbench devices",),
    "station": ("starbench station new my_bench.yaml",),
    "station new": ("starbench station new my_bench.yaml --name 'Optics bench 2' --stage ximc",),
    "simulate": ("starbench simulate --station simulated --seed 1",),
    "keys": ("starbench keys show",),
    "keys show": ("starbench keys show",),
    "keys create": ("starbench keys create --principal bench2@lab.example",),
    "keys trust": (
        "starbench keys trust 'bench2@lab.example namespaces=\"starbench-report@v1\" ssh-ed25519 AAAA...'",
    ),
    "schema": ("starbench schema sequence > sequence.schema.json",),
}

_PLAIN = "0 done, 1 failed, 2 a wrong word or file."
_RUN = "0 done, 1 failed, 2 a wrong word or file, 3 stopped on request (safe; `starbench resume` goes on)."
_COMMAND = "0 taken, 1 refused, 2 a wrong word or file."
STATUSES = {
    "run": _RUN,
    "resume": _RUN,
    "status": "0; with --follow that of the run: 0 done, 1 failed, 3 stopped on request. 2 a wrong word or file.",
    "verify": "0 as sealed, 1 not so, 2 a wrong word or file.",
    **dict.fromkeys(("hold", "release", "skip", "abort", "answer", "batch add", "batch withdraw"), _COMMAND),
    **dict.fromkeys(
        ("batch", "batch run", "batch summary", "rehearse"),
        "0 every run has a result, 1 not so, 2 a wrong word or file, 3 stopped on request.",
    ),
    "runs": "0; 1 where a run of the ledger is gone or altered; 2 a wrong word or file.",
    "messages": "0; 1 where a message still waits after --send; 2 a wrong word or file.",
}
_SHORT = {
    "run": "Run a sequence on a station, up to the sealed report.",
    "resume": "Go on with a run that was stopped, failed or cut off.",
    "plan": "Check a sequence or a queue; what it takes, what it is worth.",
    "verify": "Check the seal of a run.",
    "status": "Say how a run or a batch stands.",
    "hold": "Hold a run at its next safe point.",
    "release": "Let a held run go on.",
    "skip": "Leave out a pose.",
    "abort": "End a run now, safely.",
    "answer": "Answer the question a run asks.",
    "batch": "Do the runs of a queue file, each watched.",
    "rehearse": "Rehearse a queue on a virtual clock.",
    "runs": "List, filter and compare runs.",
    "messages": "List or send the bench's messages.",
    "calibrate": "Calibrate again, from recordings, pictures or points.",
    "passport": "Calibrate a collimator once, then cameras from 1 to 3 views.",
    "rig": "The turn between two cameras of a rig.",
    "study": "See whether stated uncertainties hold.",
    "convert": "Convert files of events.",
    "devices": "List what is connected.",
    "station": "Begin a station file.",
    "simulate": "Keep a simulated bench running.",
    "keys": "Show, make and trust signing keys.",
    "schema": "Print the JSON Schema of a kind of file.",
}


class Sections(click.Group):
    """A group that lists its commands by what they are for, each with its whole line however narrow the terminal."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections."""
        del ctx
        for title, names in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name, _SHORT[name]) for name in names], col_max=12)


def complete(group: click.Group, path: str = "") -> None:
    """Give every command below ``group`` its example and what its exit status means."""
    if not path:
        group.epilog = f"Exit status: {_RUN} 130 broken off by Ctrl-C before that."
    for name, command in group.commands.items():
        words = f"{path} {name}".strip()
        examples = "\n".join(f"  {line}" for line in EXAMPLES[words])
        several = "Examples" if len(EXAMPLES[words]) > 1 else "Example"
        command.epilog = f"\b\n{several}:\n{examples}\n\nExit status: {STATUSES.get(words, _PLAIN)}"
        if isinstance(command, click.Group):
            complete(command, words)
