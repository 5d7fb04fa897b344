"""The texts and numbers of a report, as a reader sees them."""

from html.parser import HTMLParser

_GRAPHIC_TAGS = frozenset({"section", "svg", "style"})
"""Elements whose text belongs to images and plots; in the template, sections contain nothing else."""


def printed_text(html: str) -> list[str]:
    """Extract the texts and numbers of a report, without those in images and plots.

    Two reports of the same results have the same texts, even if another version of a library encoded their images.

    Returns: Its texts in order, with spaces normalised.
    """
    reader = _TextReader()
    reader.feed(html)
    reader.close()
    return reader.texts


class _TextReader(HTMLParser):
    """Collects the text outside of images, plots and styles."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._open_graphics: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Enter an element; the text of a graphic element is ignored."""
        del attrs
        if tag in _GRAPHIC_TAGS:
            self._open_graphics.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Leave an element."""
        if self._open_graphics and self._open_graphics[-1] == tag:
            self._open_graphics.pop()

    def handle_data(self, data: str) -> None:
        """Collect a text."""
        shown = " ".join(data.split())
        if shown and not self._open_graphics:
            self.texts.append(shown)
