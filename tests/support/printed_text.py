"""The texts and numbers of a report, as a reader sees them."""

from lxml import html

_SHOWN = "//text()[not(ancestor::section or ancestor::svg or ancestor::style)]"
"""Outside of images and plots; in the template, sections contain nothing else."""


def printed_text(page: str) -> list[str]:
    """Extract the texts and numbers of a report in order, without those in images and plots; spaces normalised.

    Two reports of the same results have the same texts, even if another version of a library encoded their images.
    """
    texts = (" ".join(text.split()) for text in html.fromstring(page).xpath(_SHOWN))
    return [text for text in texts if text]
