"""Arguments and options that several commands share; paths are checked before any work begins.

A wrong one is told with what to do, exit status 2.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import click
from click.shell_completion import CompletionItem

from bench.base.errors import UsageError
from bench.base.home import expand_home
from bench.base.pasteable import pasteable
from bench.commands.values import Moment, WholeNumber
from sequences.kinds import kind_of_file

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

_Command = TypeVar("_Command", bound="Callable[..., Any]")
_INVALID = "2 invalid argument or file"
_CTRL_C = "130 ended by Ctrl-C."
PLAIN_STATUS = f"0 done, 1 failed, {_INVALID}, {_CTRL_C}"
RUN_STATUS = (
    f"0 done, 1 failed, {_INVALID}, 3 stopped on request (safe, and can be resumed), 4 done, but a limit is not kept"
    f" (FAIL), {_CTRL_C}"
)
QUEUE_STATUS = (
    f"0 every run has a result, 1 at least one run has no result, {_INVALID}, 3 stopped on request, 4 a limit of a run"
    f" is not kept (FAIL), {_CTRL_C}"
)
_MOST_NAMED = 5  # A line of a terminal

SET = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="PATH=VALUE",
    help="Replace a value of the sequence or station file, e.g. station.camera.biases.bias_diff_on=20. Can be given"
    " several times.",
)

OPERATOR = click.option("--operator", "by", metavar="NAME", help="Your name.  [default: user@host]")


SEED = WholeNumber(0, 2**63 - 1)
MOMENT = Moment(["%Y-%m-%d", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M", "%Y-%m-%dT%H:%M:%S"])
MOMENT_FORM = "DATE[THH:MM]"
BEGIN = click.option(
    "--begin",
    type=Moment(["%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M"]),
    metavar="DATETHH:MM",
    help="Time at which the night begins, in the time zone of the queue.  [default: now]",
)


def status_text(words: str) -> str:
    """Return exit statuses of a command that differ from the usual ones, completed as ``0 shown{invalid}{ctrl_c}``."""
    return words.format(invalid=f", {_INVALID}", ctrl_c=f", {_CTRL_C}")


def epilog(*examples: str, status: str = PLAIN_STATUS) -> str:
    """Return what stands below the options in the help of a command: examples, and its exit statuses."""
    title = "Examples" if len(examples) > 1 else "Example"
    lines = "\n".join(f"  {line}" for line in examples)
    return f"\b\n{title}:\n{lines}\n\nExit status: {status}"


def together(*options: Callable[[_Command], _Command]) -> Callable[[_Command], _Command]:
    """Return a decorator that adds options and arguments to a command, in this order."""

    def add(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def command(
    *examples: str, status: str = PLAIN_STATUS, name: str | None = None
) -> Callable[[Callable[..., int]], click.Command]:
    """Make a command of a function, with what `epilog` says below its options; ``name`` None is the function's."""
    return click.command(name, epilog=epilog(*examples, status=status))


class Family(click.Group):
    """Group that lists each of its commands with the whole first sentence of its help."""

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """See `click.Group.add_command`."""
        cmd.short_help = (cmd.help or "").partition("\n\n")[0].replace("\n", " ")
        super().add_command(cmd, name)


class _Path(click.ParamType, ABC):
    """A path that is checked before the command begins."""

    name = "path"
    completed_as = "file"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """See `click.ParamType.shell_complete`: the shell completes the path."""
        del ctx, param
        return [CompletionItem(incomplete, type=self.completed_as)]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path after checking it. Raises UsageError, OSError."""
        del param, ctx
        if not str(value):  # as of a variable that a script has not set; Path("") would be the current folder
            raise UsageError(
                "A path is empty.", remedy="Give its name; the current folder is a full stop (.)."
            )
        path = Path(expand_home(str(value)))
        self.check(path)
        return path

    @abstractmethod
    def check(self, path: Path) -> None:
        """Raise UsageError if the path is not of the kind that is needed."""


class ExistingFile(_Path):
    """A file that exists."""

    name = "file"

    def check(self, path: Path) -> None:
        """Check that the file exists and is not a folder, a pipe or a device."""
        if not path.exists():
            raise UsageError("There is no such file.", where=str(path), remedy="Check the path.")
        if path.is_dir():
            raise UsageError("This is a folder, not a file.", where=str(path), remedy="Name a file.")
        _require_no_device(path)


class EventFile(ExistingFile):
    """A file of events, or the folder of a ROS 2 bag."""

    def check(self, path: Path) -> None:
        """See `ExistingFile.check`; a folder with ``metadata.yaml`` is a bag."""
        if not (path / "metadata.yaml").is_file():
            super().check(path)
            _require_no_document(path)


class ExistingFolder(_Path):
    """A folder that exists."""

    name = "folder"
    completed_as = "dir"

    def check(self, path: Path) -> None:
        """Check that the folder exists."""
        if not path.is_dir():
            what = "This is a file, not a folder." if path.exists() else "There is no such folder."
            raise UsageError(what, where=str(path), remedy="Check the path.")


class ExistingPath(_Path):
    """A file or folder that exists."""

    def check(self, path: Path) -> None:
        """Check that the file or folder exists and is no pipe or device."""
        if not path.exists():
            raise UsageError("There is no such file or folder.", where=str(path), remedy="Check the path.")
        _require_no_device(path)
        _require_no_document(path)


class AnyPath(_Path):
    """A path that the command checks by itself."""

    def check(self, path: Path) -> None:
        """Check nothing yet."""


class NewFile(_Path):
    """A file that does not exist yet, in a folder that exists. Checked before long work begins."""

    name = "file"

    def check(self, path: Path) -> None:
        """Check that the name is free and the folder exists."""
        from bench.record.storage import require_free

        require_free(path)
        if path.is_dir():
            raise UsageError("This is a folder, not a file.", where=str(path), remedy="Name a new file.")
        if not path.parent.is_dir():
            raise UsageError(
                f"There is no folder {path.parent}.", where=str(path), remedy="Create the folder first."
            )


class OutputFolder(_Path):
    """A folder to write into; the command creates it if it does not exist."""

    name = "folder"
    completed_as = "dir"

    def check(self, path: Path) -> None:
        """Check that neither the path nor a folder above it is a file, and that none above it is sealed."""
        from bench.record.storage import require_unsealed

        there = next((p for p in (path, *path.parents) if os.path.lexists(p)), None)
        if there is not None and not there.is_dir():
            raise UsageError(
                f"{there} is a file, not a folder." if there != path else "This is a file, not a folder.",
                where=str(path),
                remedy="Choose another --output.",
            )
        require_unsealed(path)


class RunFolder(_Path):
    """The folder of a run, or with ``batch`` of a batch; with ``journal`` it must hold one, or be locked."""

    name = "folder"
    completed_as = "dir"

    def __init__(self, *, batch: bool = False, journal: bool = True) -> None:
        self._batch, self._journal = batch, journal

    def check(self, path: Path) -> None:
        """Check that the folder is a run, or a batch if that is accepted."""
        from bench.record.folder_lock import is_locked
        from bench.record.run_folder import JOURNAL
        from bench.record.run_index import is_batch, run_folders

        where = str(path)
        if not path.exists():
            remedy = "Check the path; `starbench runs` lists the runs of this bench."
            raise UsageError("There is no such run folder.", where=where, remedy=remedy)
        if not path.is_dir():
            inside = f" Did you mean {path.parent}?" if (path.parent / JOURNAL).is_file() else ""
            raise UsageError(
                "This is a file, not the folder of a run.", where=where, remedy=f"Check the path.{inside}"
            )
        if is_batch(path):
            if not self._batch:
                raise UsageError("This is a batch, not a run.", where=where, remedy=_batch_remedy(path))
        elif not (path / JOURNAL).is_file() and not is_locked(path) and (self._journal or run_folders(path)):
            raise UsageError(
                "This is not a run folder: it has no journal.jsonl.", where=where, remedy=_inside(path)
            )


def _require_no_document(path: Path) -> None:
    """Refuse a sequence, a station file and the like where data are needed. Raises UsageError."""
    kind = kind_of_file(path)
    if kind is not None:
        raise UsageError(f"This is {kind.words}; it holds no data.", where=str(path), remedy=kind.use)


def _require_no_device(path: Path) -> None:
    """Refuse a pipe, a socket or a device: reading it may never end. Raises UsageError."""
    if not path.is_file() and not path.is_dir():
        raise UsageError(
            "This is a pipe, a socket or a device, not a file.", where=str(path), remedy="Name a file."
        )


def _batch_remedy(path: Path) -> str:
    """Return how to continue a batch if that is possible, and where its runs are."""
    from bench.record.stored_run import StoredRun

    shown = f"`{pasteable('status', path)}` shows its runs; name one of them: {path / 'runs'}/..."
    if StoredRun(path).is_rehearsal:
        return f"This is a rehearsal. It cannot be continued. {shown}"
    return (
        f"To continue the batch: `{pasteable('batch', 'QUEUE.yaml', '--output', path)}`, where QUEUE.yaml is"
        f" the file it was begun with ({path / 'queue.yaml'} is a copy). {shown}"
    )


def _inside(path: Path) -> str:
    """Return which runs lie inside a folder that is not a run itself."""
    from bench.record.run_index import run_folders

    runs = [str(folder) for folder in run_folders(path)]
    if not runs:
        return "Name the folder of a run; `starbench runs` lists the runs of this bench."
    more = f" and {len(runs) - _MOST_NAMED} more" if len(runs) > _MOST_NAMED else ""
    return f"Name one of the runs in it: {', '.join(runs[:_MOST_NAMED])}{more}."


RUN = click.argument("run_folder", metavar="RUN", type=RunFolder())


class _NameOrFile(click.ParamType):
    """Text that names an included file (``three_pose``), below ``folder`` of Starbench, or any other file."""

    name = "text"

    def __init__(self, folder: str) -> None:
        self._folder = folder

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """See `click.ParamType.convert`."""
        del param, ctx
        return expand_home(str(value))

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """See `click.ParamType.shell_complete`."""
        del ctx, param
        names = sorted(path.stem for path in (Path(__file__).parents[2] / self._folder).glob("*.yaml"))
        items = [CompletionItem(name) for name in names if name.startswith(incomplete)]
        # The shell completes names of files by itself only if no name of ours fits.
        return items or [CompletionItem(incomplete, type="file")]


SEQUENCE_NAME = _NameOrFile("sequences")
STATION_NAME = _NameOrFile("bench/stations")


ALLOWED_SIGNERS = click.option(
    "--allowed-signers", type=ExistingFile(), help="File of trusted keys.  [default: this bench's own]"
)
TSA_CERTIFICATES = click.option(
    "--tsa-certificates",
    type=ExistingFile(),
    help="Root certificates of trusted time stamping authorities, PEM.  [default: this bench's own]",
)
STATION = click.option(
    "--station",
    "-s",
    required=True,
    type=STATION_NAME,
    help="Station file, or the name of a station that is included (simulated).",
)
page_options = together(
    click.option(
        "--port",
        type=WholeNumber(0, 65535),
        default=0,
        metavar="N",
        help="Port of the page.  [default: a free one]",
    ),
    click.option(
        "--host",
        default="127.0.0.1",
        metavar="NAME",
        help="Name or address at which to serve the page. If other computers can reach it, the page needs a token: the "
        "one in the variable STARBENCH_PAGE_TOKEN; without it, a new one in the printed address. The connection is not "
        "encrypted. An encrypted one needs no --host: ssh -L PORT:127.0.0.1:PORT COMPUTER.  [default: 127.0.0.1, this "
        "computer only]",
    ),
    click.option(
        "--no-token",
        is_flag=True,
        help="Let every user and program of this computer use the page, also to stop, move or abort.",
    ),
    click.option("--no-browser", is_flag=True, help="Do not open the page in a browser."),
)
"""The options that `panel` and `align` share: ``port host no_token no_browser``."""

run_options = together(
    click.argument("folder", required=False, type=ExistingFolder()),
    click.option("--serial", metavar="NUMBER", help="Only runs of the camera with this serial number."),
    click.option(
        "--since", type=MOMENT, metavar=MOMENT_FORM, help="Only runs that began at or after this time (UTC)."
    ),
    click.option(
        "--until", type=MOMENT, metavar=MOMENT_FORM, help="Only runs that began before this time (UTC)."
    ),
    click.option("--sequence", help="Only runs whose sequence name contains this text."),
    click.option(
        "--ledger",
        "ledgers",
        multiple=True,
        metavar="FOLDER",
        type=ExistingFolder(),
        help="Read the ledger in this folder, not that of this bench. The folder is the configuration folder of another"
        " bench, or a copy of it. Give the option several times to merge several benches.",
    ),
)
"""What names runs, for `RunChoice.of`: ``folder serial since until sequence ledgers``."""


@dataclass(frozen=True)
class RunChoice:
    """Which runs a command is about."""

    folder: Path | None  # Folder whose runs to list; all runs of the ledger where None
    # Configuration folders of the benches whose ledgers to merge; this bench's own where empty.
    ledgers: Sequence[Path]
    filters: Mapping[str, Any]  # As `bench.record.run_index.RunIndex.runs` takes them

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Return the choice that `run_options` name, and with ``how`` the outcome."""
        moments = {
            name: moment.replace(tzinfo=UTC) if (moment := given[name]) else None
            for name in ("since", "until")
        }
        filters = {"camera": given["serial"], "sequence": given["sequence"], "how": given.get("how")}
        return cls(given["folder"], given["ledgers"], {**filters, **moments})


def settings_of(texts: tuple[str, ...]) -> Mapping[str, str]:
    """Split the PATH=VALUE of ``--set``."""
    from sequences.reader import OptionSettings

    for text in texts:
        if "=" not in text:
            raise click.BadParameter(f"{text!r} does not have the form PATH=VALUE.", param_hint="--set")
    pairs = (text.partition("=") for text in texts)
    return OptionSettings({path.strip(): value for path, _, value in pairs}, "--set")
