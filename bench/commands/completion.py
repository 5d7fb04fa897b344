"""Completion of arguments in the shell: names of shipped files and paths, besides the commands and options of click.

The module only proposes words; it checks nothing. docs/first-steps.md says how to switch completion on.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

_ROOT = Path(__file__).parents[2]
_SHIPPED = {"station": _ROOT / "bench" / "stations", "sequence": _ROOT / "sequences"}


class _NameOrFile(click.ParamType):
    """Text that names a shipped file or any other file."""

    name = "text"

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """See `click.ParamType.convert`."""
        del param, ctx
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """See `click.ParamType.shell_complete`."""
        del ctx, param
        names = sorted(path.stem for path in self._folder.glob("*.yaml"))
        found = [CompletionItem(name) for name in names if name.startswith(incomplete)]
        # The shell completes names of files by itself only if no name of ours fits.
        return found or [CompletionItem(incomplete, type="file")]


def add_completion(group: click.Group) -> None:
    """Let the shell complete stations and sequences of every command below a group."""
    for command in group.commands.values():
        for param in command.params:
            if param.name in _SHIPPED and isinstance(param.type, click.types.StringParamType):
                param.type = _NameOrFile(_SHIPPED[param.name])
        if isinstance(command, click.Group):
            add_completion(command)
