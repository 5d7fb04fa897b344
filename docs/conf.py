"""The site of the documents: `make docs` builds it into build/site, and it needs no network.

The pages are those that GitHub shows. `README.md` is the front page; the lists of `pages.md` are the side bar.
Decisions and measured tables are left out of the search, so that it gives the page that says how.
Links to files outside of the documents are shown as names, and formulas are MathML, which browsers draw themselves.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

from bench import __version__

project = "Starbench"
author = "The Starbench authors"
release = version = __version__
root_doc = "README"
exclude_patterns = ["plugins/**"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]

html_theme = "furo"
html_title = f"Starbench {version}"
html_show_sourcelink = False
html_copy_source = False

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 6
suppress_warnings = ["ref.python"]  # a name in a docstring may be that of two attributes

default_role = "py:obj"  # `name` in a docstring links to what is documented, and is plain text otherwise
autodoc_member_order = "groupwise"
autodoc_typehints = "signature"
napoleon_google_docstring = False
napoleon_use_ivar = True

DOCS = Path(__file__).parent
_MERMAID = re.compile(r"```mermaid\n.*?```", re.DOTALL)
_LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)(#[^)]*)?\)")
_LISTED = re.compile(r"\]\((?!https?:|\.\./)([^)#\s]+\.(?:md|rst))\)")


def as_site(app: Any, page: str, source: list[str]) -> None:
    """Turn a page of GitHub into one of the site."""
    folder = (DOCS / page).parent
    text = _MERMAID.sub("![The states of a run](pictures/states.svg)", source[0])
    text = _LINK.sub(lambda link: link[0] if _within(folder, link[2]) else link[1], text)
    if page.endswith("README"):
        text = "".join(_with_side_bar(text))
    if page == root_doc:
        if app is not None:
            app.env.note_dependency(str(DOCS / "pages.md"))
        text += "".join(map(_side_bar, _parts((DOCS / "pages.md").read_text(encoding="utf-8"))))
    if page == "pages":
        text = "---\norphan: true\n---\n" + text
    if page.startswith(("decisions/", "measured/")):
        text = "---\nnosearch: true\n---\n" + text
    source[0] = text


def _within(folder: Path, target: str) -> bool:
    """Whether a link leads to a page, a picture or another site."""
    if target.startswith(("http://", "https://")):
        return True
    path = (folder / target).resolve()
    return path.is_file() and path.is_relative_to(DOCS) and path.suffix in {".md", ".rst", ".png", ".svg"}


def _with_side_bar(text: str) -> list[str]:
    """Add to each part of a front page the pages that its list names, for the side bar."""
    return [part + _side_bar(part) for part in _parts(text)]


def _parts(text: str) -> list[str]:
    return re.split(r"^(?=## )", text, flags=re.MULTILINE)


def _side_bar(part: str) -> str:
    """Return the hidden list of the pages that a part of a front page names; its heading is the caption."""
    pages = list(dict.fromkeys(_LISTED.findall(part)))
    if not pages or not part.startswith(("## ", "# Decisions", "# Measured")):
        return ""
    caption = [f":caption: {part.partition(chr(10))[0].strip('# ')}"] if part.startswith("## ") else []
    return "\n".join(["\n```{toctree}", ":hidden:", *caption, "", *pages, "```", ""])


def _as_typed(app: Any, context: Any, lines: list[str]) -> None:
    """Keep the star of ``runs/*`` in the examples of a command: it begins no emphasis."""
    del app, context
    lines[:] = [line.replace("*", r"\*") for line in lines]


def _draw_formula(translator: Any, node: Any) -> None:
    """Write a formula within a line as MathML."""
    from docutils import nodes

    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _draw_formula_block(translator: Any, node: Any) -> None:
    """Write a formula on lines of its own as MathML."""
    from docutils import nodes

    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div style="overflow-x: auto">{formula}</div>')
    raise nodes.SkipNode


def _add_index(app: Any, error: Exception | None) -> None:
    """Let a folder open at its front page."""
    if error is None:
        shutil.copyfile(Path(app.outdir) / "README.html", Path(app.outdir) / "index.html")


def setup(app: Any) -> None:
    """Register the above with Sphinx."""
    from sphinx.application import Sphinx

    assert isinstance(app, Sphinx)
    app.connect("source-read", as_site)
    app.connect("sphinx-click-process-epilog", _as_typed)
    app.connect("build-finished", _add_index)
    app.registry.html_inline_math_renderers["mathml"] = (_draw_formula, None)
    app.registry.html_block_math_renderers["mathml"] = (_draw_formula_block, None)


html_math_renderer = "mathml"
