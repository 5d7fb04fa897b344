"""Checks views.h5 of a run against its results: poses, stars, residuals, and that the file holds nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from bench.base.errors import RunFolderError
from bench.evidence.findings import Findings
from bench.records.results import Results
from bench.records.run_folder import RESULTS
from bench.report.choice import pictured_poses
from bench.report.view_picture import ViewPicture
from bench.results.other_software import other_software
from bench.views.views_file import VIEWS, StoredView, has_pictures, read_picture, read_views, views_file
from calib.view import View

_SAME_RMS = 1e-9
"""Largest relative difference of a root mean square that rounding explains."""


@dataclass(frozen=True)
class _Picture:
    """An image of views.h5; read when it is needed, because a run may have a thousand."""

    read: Callable[[], NDArray[np.uint8]]

    def decoded(self) -> NDArray[np.uint8]:
        return self.read()


@dataclass(frozen=True)
class _Found:
    """A view and its image, as `bench.views.views_file.views_file` takes them."""

    view: View
    image: _Picture | None


@dataclass(frozen=True)
class RunViews:
    """The content of views.h5."""

    views: Sequence[StoredView]
    # For each pose a function that reads its image, (H, W) uint8; None for recalculated results, which have
    # no images.
    pictures: Sequence[Callable[[], NDArray[np.uint8]] | None]

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a views.h5; its images are read when they are needed.

        Raises RunFolderError: When the file cannot be read, or does not have this layout.
        """
        views, pictured = read_views(path), has_pictures(path)
        numbers = range(1, len(views) + 1)
        return cls(views, [partial(read_picture, path, number) if pictured else None for number in numbers])

    def as_file(self) -> bytes:
        """Return the bytes of a views.h5 with this content.

        Raises RunFolderError: When an image cannot be read.
        """
        return views_file(
            [
                _Found(stored.view, None if read is None else _Picture(read))
                for stored, read in zip(self.views, self.pictures, strict=True)
            ],
            [stored.residuals_px for stored in self.views],
        )

    def shown(self, results: Mapping[str, Any]) -> list[ViewPicture]:
        """Return the poses as the report shows them.

        Raises RunFolderError: When an image cannot be read.
        """
        names = pictured_poses(cast("Results", results)).names
        return [
            ViewPicture(
                stored.view.name,
                read() if read is not None and stored.view.name in names else None,
                stored.view.points_px,
                stored.view.points_px - stored.residuals_px,
                stored.view.ids,
            )
            for stored, read in zip(self.views, self.pictures, strict=True)
        ]


def check_views(
    folder: Path, results: Mapping[str, Any], found: Findings, *, all_stars: bool = True
) -> RunViews | None:
    """Compare views.h5 of a run or of recalculated results with results.json.

    found: Findings; faults are added.
    all_stars: Whether the calibration used all stars; with a guard band it leaves some out.
    Returns: What the file holds; None if it cannot be read.
    """
    path = folder / VIEWS
    try:
        held = RunViews.read(path)
        again = held.as_file()  # this reads every image
    except (RunFolderError, MemoryError, RuntimeError) as error:
        what = error.what if isinstance(error, RunFolderError) else f"the file cannot be read ({error!r})"
        found.fault("views", VIEWS, what)
        return None
    views = held.views
    solved = results["calibration"]["views"]
    names = [stored.view.name for stored in views], [view["name"] for view in solved]
    if names[0] != names[1]:
        found.fault("views", VIEWS, f"it holds the poses {names[0]}; {RESULTS} has {names[1]}")
        return None
    for stored, view in zip(views, solved, strict=True):
        if all_stars:
            _check_residuals(stored, view, found)
    _check_bytes(path, again, results, found)
    return held


def _check_residuals(stored: StoredView, view: Mapping[str, Any], found: Findings) -> None:
    lengths = np.linalg.norm(stored.residuals_px, axis=1)
    numbers = {
        "n": (float(len(lengths)), float(view["n"])),
        "rms_px": (float(np.sqrt(np.mean(lengths**2))), view["rms_px"]),
        "mean_px": (float(np.mean(lengths)), view["mean_px"]),
    }
    for name, (here, stated) in numbers.items():
        if not abs(here - stated) <= _SAME_RMS * abs(here):
            what = f"its residuals of {stored.view.name} give {name} = {here:.9g}; {RESULTS} has {stated:.9g}"
            found.fault("views", VIEWS, what)


def _check_bytes(path: Path, again: bytes, results: Mapping[str, Any], found: Findings) -> None:
    """Write the content again: a file with the same bytes holds nothing besides it."""
    if path.read_bytes() == again:
        return
    if other := other_software(results, ("starbench", "h5py", "numpy", "program")):
        found.not_compared.append(f"bytes of {VIEWS} with its content: it was made with {other}")
    else:
        found.fault(
            "views",
            VIEWS,
            "it holds more than stars, residuals and images, or was not written by this program",
        )
