"""What a page is made of, and what the tables of a page show."""

from html.parser import HTMLParser

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Structure(HTMLParser):
    """Tags, attributes and whether every element is closed where it should be."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.open, self.wrong = [], [], [], []
        self.feed(html)
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


class Cells(HTMLParser):
    """Rows of the table with an accessible name: the text of each cell, "[class] " before what stands in a pill."""

    def __init__(self, page, name):
        super().__init__()
        self.name, self.rows, self.inside, self.cell = name, [], False, False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        told = dict(attrs)
        self.inside |= told.get("aria-label") == self.name
        if tag == "tr" and self.inside:
            self.rows.append([])
        elif tag == "td" and self.inside:
            self.rows[-1].append("")
            self.cell = True
        elif self.cell and (told.get("class") or "").startswith(("pill", "drift")):
            self.rows[-1][-1] += f"[{told['class'].removeprefix('pill ')}] "

    def handle_data(self, data):
        if self.cell:
            self.rows[-1][-1] += data

    def handle_endtag(self, tag):
        self.cell &= tag != "td"
        self.inside &= tag != "table"


def cells(page, name):
    """The rows of the table, without its heading."""
    return [row for row in Cells(page, name).rows if row]
