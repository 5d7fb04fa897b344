"""What a certificate as PDF prints, as data: the blocks that its layout is given."""

import json
from importlib import resources

import typst

from bench.extras.certificate.pdf import document


def value_of(expression, data=None):
    """Return the value of an expression of `content.typ`, in which ``d`` is the document."""
    folder = resources.files("bench.extras.certificate")
    main = (
        '#import "content.typ"\n#import "content_numbers.typ"\n#let d = json("document.json")\n'
        f"#metadata({expression}) <found>"
    )
    files = {file.name: file.read_bytes() for file in folder.iterdir() if file.name.endswith(".typ")}
    files |= {"main.typ": main.encode(), "document.json": json.dumps(data).encode()}
    return json.loads(typst.Compiler(files).query("<found>", field="value", one=True))


def opening_of(certificate):
    """Return what stands above the first section."""
    return value_of("content.opening(d)", document(certificate, [], {}))


def sections_of(certificate, attachments):
    """Return the sections: title and blocks of each."""
    return value_of("content.sections(d)", document(certificate, [], attachments))
