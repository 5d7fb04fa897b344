"""What a page is made of, and what the tables of a page show."""

from html.parser import HTMLParser

from lxml import html

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Structure(HTMLParser):
    """Tags, attributes and whether every element is closed where it should be."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes, self.open, self.wrong = [], [], [], []
        self.feed(page)
        self.close()

    @property
    def links(self):
        """What the page loads or leads to."""
        return [
            value for _, name, value in self.attributes if name in {"src", "href", "xlink:href"} and value
        ]

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append((tag, self.getpos()))


def cells(page, name):
    """The rows of the table with an accessible name, without its heading: the text of each cell."""
    rows = html.fromstring(page).xpath(f'//*[@aria-label="{name}"]//tr[td]')
    return [[_shown(cell) for cell in row.findall("td")] for row in rows]


def _shown(element):
    """The text of an element, "[class] " before what stands in a pill."""
    kind = element.get("class", "")
    mark = f"[{kind.removeprefix('pill ')}] " if kind.startswith(("pill", "drift")) else ""
    return mark + (element.text or "") + "".join(_shown(child) + (child.tail or "") for child in element)
