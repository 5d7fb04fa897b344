"""Makes the pictures of README and documents from the present version: report, align page and panel. It needs Chromium.

    make pictures

It runs the demonstration, aligns the simulated bench, and watches a second run. Each picture is below 200 kB.
"""

import io
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

from bench.extras.pages.align.align_app import align_app
from bench.extras.pages.align.session import Session
from bench.extras.pages.panel.panel_app import panel_app
from bench.stations.station import load_station
from tests.extras.support.pages import served
from tests.support.align_browser import running_chromium
from tests.support.waiting import wait_until

PICTURES = Path(__file__).parents[3] / "docs" / "pictures"
WIDTH_PX = 1160
PARTS = {"report.png": ("Calibration report", 1180), "report-plots.png": ("Where the result holds", 420)}
"""Heading with which each picture of the report begins, and its height, px."""
LAPTOP = {"width": 1366, "height": 768}
MOST_BYTES = 200_000
PATIENCE_S = 180.0


def save(picture: Image.Image, name: str) -> None:
    """Write a picture with as many colours as its size allows; refuse one that is too large."""
    path = PICTURES / name
    for colours in (256, 128, 64, 32):
        picture.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
        size = path.stat().st_size
        if size <= MOST_BYTES:
            break
    print(f"{path.name}: {picture.size[0]} x {picture.size[1]} px, {size} bytes")
    if size > MOST_BYTES:
        raise SystemExit(f"{path} is larger than {MOST_BYTES} bytes.")


def shot(page: Any, **options: Any) -> Image.Image:
    """Return what a page shows."""
    return Image.open(io.BytesIO(page.screenshot(**options))).convert("RGB")


def report_pictures(browser: Any, run: Path) -> None:
    """Picture the head of a report, and its maps."""
    page = browser.new_page(viewport={"width": WIDTH_PX, "height": 900})
    page.goto((run / "report.html").resolve().as_uri())
    whole = shot(page, full_page=True)
    for name, (heading, height_px) in PARTS.items():
        box = page.get_by_role("heading", name=heading, exact=True).first.bounding_box()
        if box is None:
            raise SystemExit(f"The report has no heading {heading!r}.")
        top = 0 if name == "report.png" else round(box["y"]) - 12
        save(whole.crop((0, top, WIDTH_PX, min(top + height_px, whole.size[1]))), name)


def align_picture(browser: Any) -> None:
    """Picture the align page over a bench that is homed, lit, and somewhat out of focus."""
    session = Session(load_station("simulated"))
    if (failure := session.open()) is not None:
        raise SystemExit(failure.message)
    try:
        with served(align_app(session)) as server:
            page = browser.new_page(viewport=LAPTOP)
            page.goto(server.url)
            page.click("#home")
            page.click("#home-now")
            wait_until(
                lambda: session.bench.stage.state.homed and not session.bench.stage.moving,
                PATIENCE_S,
                "homing",
            )
            page.click("#light-on")
            for step in ("20", "-5", "-5"):  # out of focus, and some of the way back
                button = f"[data-action='lens turn'] [data-step='{step}']"
                page.eval_on_selector(button, "button => button.click()")
                page.wait_for_timeout(8000)
            page.eval_on_selector("#curve", "curve => curve.scrollIntoView({block: 'end'})")
            save(shot(page), "align.png")
    finally:
        session.close()


def panel_picture(browser: Any, runs: Path) -> None:
    """Picture the panel while a run records."""
    run = runs / "second"
    words = ["run", "three_pose", "--station", "simulated", "--output", str(run)]
    process = subprocess.Popen([sys.executable, "-m", "bench", *words], stderr=subprocess.DEVNULL)
    try:
        wait_until(
            lambda: (run / "captures").is_dir() and any((run / "captures").iterdir()),
            PATIENCE_S,
            "a recording",
        )
        with served(panel_app(runs)) as server:
            page = browser.new_page(viewport={"width": WIDTH_PX, "height": 900})
            page.goto(f"{server.url}run/second")
            wait_until(lambda: "accepted" in page.inner_text("#log"), PATIENCE_S, "an accepted pose")
            page.wait_for_timeout(1000)
            save(shot(page), "panel.png")
    finally:
        process.wait()


def main() -> None:
    """Make all pictures."""
    with tempfile.TemporaryDirectory() as name, running_chromium() as browser:
        runs = Path(name) / "runs"
        demo = ["run", "three_pose", "--station", "simulated", "--output", str(runs / "demo")]
        subprocess.run([sys.executable, "-m", "bench", *demo], check=True)
        report_pictures(browser, runs / "demo")
        align_picture(browser)
        panel_picture(browser, runs)


if __name__ == "__main__":
    main()
