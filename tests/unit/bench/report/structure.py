"""What a page is made of."""

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
