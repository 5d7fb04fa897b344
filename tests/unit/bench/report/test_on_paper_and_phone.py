"""The report in a browser: few printed pages without gaps, and nothing cut on a phone."""

import re
from pathlib import Path

from align_browser import running_chromium

CUT = """() => [...document.querySelectorAll('main *')].filter(e => {
  const r = e.getBoundingClientRect();
  return r.width > 0 && r.right > innerWidth + 1 && !e.closest('.wide, svg');
}).map(e => e.outerHTML.slice(0, 80))"""
SCROLLS = """() => [...document.querySelectorAll('.wide')].filter(e =>
  e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).overflowX === 'visible').length"""


OVERLAPS = """() => [...document.querySelectorAll('.pair > *, .panels > *, .residuals > *')].filter(e =>
  e.scrollWidth > e.clientWidth + 1).map(e => e.outerHTML.slice(0, 80))"""


WIDER = """() => [...document.querySelectorAll('table')].filter(e => e.scrollWidth > innerWidth - 30)
  .map(e => e.className || e.closest('.wide')?.ariaLabel)"""


BROKEN_NUMBERS = """() => [...document.querySelectorAll('table.result td.factor')].filter(e =>
  e.offsetHeight > 1.8 * parseFloat(getComputedStyle(e).fontSize)).map(e => e.textContent)"""


BESIDE_THEIR_MEANING = """() => [...document.querySelectorAll('table.result tr:has(.meaning)')].filter(e =>
  e.querySelector('.value').getBoundingClientRect().top
    < e.querySelector('.meaning').getBoundingClientRect().bottom - 4).map(e => e.textContent)"""


def test_it_prints_on_at_most_six_pages_and_fits_a_phone(html, tmp_path):
    page_file, pdf = tmp_path / "report.html", tmp_path / "report.pdf"
    page_file.write_text(html, encoding="utf-8")
    with running_chromium() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.goto(Path(page_file).as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate(CUT) == []
        assert page.evaluate(SCROLLS) == 0
        assert page.evaluate(BROKEN_NUMBERS) == []
        assert page.evaluate(BESIDE_THEIR_MEANING) == []
        assert not page.is_visible("td.pure >> nth=0")  # a unit "1" after an uncertainty reads as a number
        page.evaluate("document.getElementById('details').open = true")
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate(WIDER) == []  # each row is a card
        page.evaluate("document.getElementById('details').open = false")
        page.set_viewport_size({"width": 1200, "height": 900})
        assert page.evaluate(OVERLAPS) == []
        page.pdf(path=str(pdf), prefer_css_page_size=True, print_background=True)
    pages = len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes()))
    assert 1 < pages <= 6
