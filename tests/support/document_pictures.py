"""Renders the pictures of a report for the documents, from the folder of a finished run.

    python tests/support/document_pictures.py runs/demo

It writes docs/pictures/report.png and docs/pictures/report-plots.png, each below 200 kB. It needs Chromium.
"""

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

PICTURES = Path(__file__).parents[2] / "docs" / "pictures"
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
]
FLAGS += ["--disable-component-update", "--disable-sync"]
WIDTH_PX = 1160
PARTS = {"report.png": ("Calibration report", 1180), "report-plots.png": ("Where the result holds", 530)}
"""Heading with which each picture begins, and its height, px."""
MOST_BYTES = 200_000


def save(picture: Image.Image, name: str) -> None:
    """Write a picture with 256 colours; refuse one that is too large."""
    path = PICTURES / name
    picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path.name}: {picture.size[0]} x {picture.size[1]} px, {size} bytes")
    if size > MOST_BYTES:
        raise SystemExit(f"{path} is larger than {MOST_BYTES} bytes.")


def main(run: str) -> None:
    """Render the head of the report, and its maps."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        raise SystemExit("Chromium is not installed.")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": WIDTH_PX, "height": 900})
        page.goto((Path(run) / "report.html").resolve().as_uri())
        whole = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
        for name, (heading, height_px) in PARTS.items():
            box = page.get_by_role("heading", name=heading, exact=True).first.bounding_box()
            if box is None:
                raise SystemExit(f"The report has no heading {heading!r}.")
            top = 0 if name == "report.png" else round(box["y"]) - 12
            save(whole.crop((0, top, WIDTH_PX, min(top + height_px, whole.size[1]))), name)
        browser.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
