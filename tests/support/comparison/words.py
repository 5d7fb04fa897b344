"""Words of a call to the commands of 2f3d5194, as a checkout with other commands wants them."""

from pathlib import Path

_RENAMED = {
    ("recalibrate",): ("calibrate", "--each"),
    ("ledger", "check"): ("ledger",),
    ("target", "show"): ("target",),
    ("target", "draw"): ("target",),
    ("keys", "list"): ("keys", "show"),
    ("certificate", "list"): ("certificate", "show"),
    ("certificate", "amend"): ("certificate", "issue"),
}
_TOLD = {"hold", "release", "skip", "abort", "answer"}


def words_for(checkout: Path, words: list[str]) -> list[str]:
    """Return the words that do the same there."""
    if "is now `starbench" not in (checkout / "bench" / "commands" / "cli.py").read_text():
        return words
    if words and words[0] in _TOLD:
        word, run, *rest = words
        return ["tell", run, *rest] if word == "answer" else ["tell", run, word, *rest]
    for count in (1, 2):
        if (now := _RENAMED.get(tuple(words[:count]))) is not None:
            return [*now, *words[count:]]
    return words
