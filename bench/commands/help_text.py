"""Text of `--help` besides the options: groups of commands, examples, exit statuses.

This module holds only the names of the commands. `complete` adds examples and exit statuses to a finished command
line.
"""

from __future__ import annotations

import click

SECTIONS = {
    "Before a run": ("align",),
    "A run": ("plan", "run", "resume", "verify"),
    "While it runs, from another terminal": ("panel", "status", "hold", "release", "skip", "abort", "answer"),
    "After a run": ("certificate",),
    "Many runs": ("batch", "rehearse", "runs", "ledger", "messages"),
    "Without devices": ("calibrate", "recalibrate", "passport", "rig", "study", "compare", "convert"),
    "The bench": ("devices", "station", "target", "simulate", "keys", "schema"),
}

EXAMPLES = {
    "align": (
        "starbench align --station my_bench.yaml",
        "starbench align --station simulated --text",
    ),
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
        "starbench verify runs/* --again --workers 4 -o checked",
    ),
    "status": ("starbench status runs/cam7 --follow", "starbench status runs/night"),
    "panel": ("starbench panel", "starbench panel runs/night --port 8800 --no-browser"),
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
    "recalibrate": (
        "starbench recalibrate runs/ --output recalculated --workers 4",
        "starbench recalibrate s3://captures/2026 --scheduler tls://cluster.lab:8786 -o recalculated",
    ),
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
    "passport seal": ("starbench passport seal collimator.json -o collimator_sealed.json",),
    "passport show": ("starbench passport show collimator.json",),
    "rig": ("starbench rig runs/left runs/right",),
    "compare": (
        "starbench compare table1 --repetitions 3",
        "starbench compare my_comparison.yaml -o comparisons/mine",
    ),
    "study": (
        "starbench study nine_pose --runs 500 --plot errors.svg",
        "starbench study nine_pose --runs 100000 --scheduler tls://cluster.lab:8786 -o study",
    ),
    "convert": (
        "starbench convert pose-001-attempt-1.raw pose.hdf5",
        "starbench convert pose.hdf5 pose.raw",
        "starbench convert captures/*.raw converted/ --as hdf5",
    ),
    "devices": ("starbench devices",),
    "station": ("starbench station new my_bench.yaml",),
    "station new": (
        "starbench station new my_bench.yaml --name 'Optics bench 2' --stage ximc --light gardasoft",
    ),
    "target": ("starbench target draw -s my_bench.yaml -o reticle.gds",),
    "target draw": (
        "starbench target draw -s my_bench.yaml -o reticle.gds",
        "starbench target draw -s simulated -o target.pdf",
    ),
    "target show": (
        "starbench target show -s my_bench.yaml",
        "starbench target show -s simulated --focal-length-mm 12 --r-mm 200",
    ),
    "simulate": ("starbench simulate --station simulated --seed 1",),
    "keys": ("starbench keys show",),
    "keys show": ("starbench keys show",),
    "keys create": ("starbench keys create --principal bench2@lab.example",),
    "keys list": ("starbench keys list",),
    "keys trust": (
        "starbench keys trust 'bench2@lab.example namespaces=\"starbench-report@v1\" ssh-ed25519 AAAA...'",
        "starbench keys trust id_ed25519.pub --person ada@lab.example --valid-before 2028-01-01",
    ),
    "keys rotate": ("starbench keys rotate --old-key delete",),
    "keys revoke": ("starbench keys revoke SHA256:... --reason 'laptop stolen'",),
    "certificate": (
        "starbench certificate new -o lab.yaml",
        "starbench certificate issue runs/cam7 --config lab.yaml -o certificates/2026-0042",
        "starbench certificate authorise certificates/2026-0042 --key ~/.ssh/id_ed25519",
    ),
    "certificate new": ("starbench certificate new -o lab.yaml",),
    "certificate issue": (
        "starbench certificate issue runs/cam7 --config lab.yaml -o certificates/2026-0042",
    ),
    "certificate amend": (
        "starbench certificate amend certificates/2026-0042 -c lab.yaml -o new --reason 'wrong address'",
    ),
    "certificate void": ("starbench certificate void SB-2026-00042 --reason 'the disk broke'",),
    "certificate list": ("starbench certificate list",),
    "certificate show": ("starbench certificate show certificates/2026-0042",),
    "certificate from-dcc": ("starbench certificate from-dcc collimator.xml",),
    "certificate check": ("starbench certificate check certificates/2026-0042",),
    "certificate authorise": (
        "starbench certificate authorise certificates/2026-0042 --key ~/.ssh/id_ed25519",
        "starbench certificate authorise certificates/2026-0042 --key SHA256:...",
    ),
    "certificate timestamp": (
        "starbench certificate timestamp certificates/2026-0042 --tsa https://tsa.example/tsr",
        "starbench certificate timestamp certificates/2026-0042 --request request.tsq",
        "starbench certificate timestamp certificates/2026-0042 --token reply.tsr",
    ),
    "ledger": ("starbench ledger check",),
    "ledger check": ("starbench ledger check",),
    "ledger forget-place": (
        "starbench ledger forget-place /mnt/office/bench2.heads --reason 'The office has a new server.'",
    ),
    "ledger explain": ("starbench ledger explain --reason 'The disk was restored from the copy of Monday.'",),
    "schema": ("starbench schema sequence > sequence.schema.json",),
}

_INVALID = "2 invalid argument or file"
_CTRL_C = "130 ended by Ctrl-C."
_PLAIN = f"0 done, 1 failed, {_INVALID}, {_CTRL_C}"
_RUN = f"0 done, 1 failed, {_INVALID}, 3 stopped on request (safe, and can be resumed), {_CTRL_C}"
_COMMAND = f"0 accepted, 1 refused, {_INVALID}, {_CTRL_C}"
STATUSES = {
    "align": f"0 ended, every device confirmed a safe state, 1 a device did not, {_INVALID}.",
    "run": _RUN,
    "resume": _RUN,
    "status": f"0 status shown, {_INVALID}, {_CTRL_C} With --follow that of the run: 0 done, 1 failed, 3 stopped.",
    "verify": f"0 valid, 1 not valid, {_INVALID}, 4 seal valid, but not every part could be compared, {_CTRL_C}",
    **dict.fromkeys(("hold", "release", "skip", "abort", "answer", "batch add", "batch withdraw"), _COMMAND),
    **dict.fromkeys(
        ("batch", "batch run", "batch summary", "rehearse"),
        f"0 every run has a result, 1 at least one run has no result, {_INVALID}, 3 stopped on request, {_CTRL_C}",
    ),
    "runs": f"0 runs shown, 1 a run is missing or was changed, or the ledger is broken, {_INVALID}, {_CTRL_C}",
    "ledger check": f"0 no fault, 1 a fault, {_INVALID}, {_CTRL_C}",
    "messages": f"0 messages shown, 1 a message is still waiting after --send, {_INVALID}, {_CTRL_C}",
}
_SHORT = {
    "align": "Aim and focus the camera with a live picture.",
    "run": "Run a sequence on a station and write a sealed report.",
    "resume": "Continue a run that was stopped, failed or was interrupted.",
    "plan": "Check a sequence or a queue; show time, disk space and expected uncertainty.",
    "verify": "Check a sealed run, certificate or recalculated results.",
    "certificate": "Issue, amend, authorise and list calibration certificates.",
    "status": "Show the status of a run or a batch.",
    "panel": "Watch and steer runs and batches in a browser.",
    "hold": "Hold a run at its next safe point.",
    "release": "Let a held run continue.",
    "skip": "Skip a pose.",
    "abort": "End a run now, safely.",
    "answer": "Answer a question that a run asks.",
    "batch": "Do all runs of a queue file; a second process supervises each run.",
    "rehearse": "Try a queue without devices: a night takes about a minute.",
    "runs": "List, filter and compare runs; draw control charts.",
    "ledger": "Check the ledger of this bench; explain a break in it.",
    "messages": "List or send the messages of this bench.",
    "recalibrate": "Calibrate many runs again, on all processors or on a cluster.",
    "calibrate": "Calibrate from existing recordings, images or point files.",
    "passport": "Calibrate a collimator once; a camera then needs 1 to 3 views.",
    "rig": "Calculate the rotation between two cameras of a rig.",
    "study": "Check by simulation whether the stated uncertainties are right.",
    "compare": "Compare calibration methods where the truth is known.",
    "convert": "Convert event files to and from the formats of other programs.",
    "devices": "List connected devices.",
    "station": "Create a station file.",
    "target": "Draw the target; show which camera and collimator it suits.",
    "simulate": "Keep a simulated bench running.",
    "keys": "Show, create, trust, replace and revoke signing keys.",
    "schema": "Print the JSON Schema of a kind of file, for an editor.",
}


class Sections(click.Group):
    """Group that lists its commands by purpose, each on one whole line at any terminal width."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """See `click.Group.format_commands`."""
        del ctx
        for title, names in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name, _SHORT[name]) for name in names], col_max=13)


def complete(group: click.Group, path: str = "") -> None:
    """Add examples and exit statuses to the help of every command below ``group``.

    path: Names of the groups above ``group``, separated by spaces; empty for the program itself.
    """
    if not path:
        group.epilog = f"Exit status: {_RUN}"
    for name, command in group.commands.items():
        full_name = f"{path} {name}".strip()
        examples = "\n".join(f"  {line}" for line in EXAMPLES[full_name])
        title = "Examples" if len(EXAMPLES[full_name]) > 1 else "Example"
        if path:  # in the list of a group: the whole first sentence, not its begin
            command.short_help = (command.help or "").partition("\n\n")[0].replace("\n", " ")
        command.epilog = f"\b\n{title}:\n{examples}\n\nExit status: {STATUSES.get(full_name, _PLAIN)}"
        if isinstance(command, click.Group):
            complete(command, full_name)
