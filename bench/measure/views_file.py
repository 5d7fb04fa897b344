"""`views.h5`: stars, residuals and image of each calibrated pose (layout: docs/run-folder.md)."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import RunFolderError
from bench.measure.view_picture import ViewPicture
from bench.record.storage import storage_errors
from calib.errors import InputMismatch
from calib.view import RimPoints, View
from drivers.camera.formats.hdf5_reading import dataset, member, whole
from drivers.camera.raw_check import require_regular
from drivers.errors import RecordingFileError

VIEWS = "views.h5"
FORMAT = "starbench/views/1"

_ARRAYS = {"ids": np.int64, "points_px": np.float64, "target_mm": np.float64, "covariances_px2": np.float64}
_RIM = ("points_mm", "sigmas_mm", "lit_mm")
_MOST_BYTES = 1 << 30  # Far above the arrays of a view
_REMEDY = "Copy the folder without this file: `starbench.load` of the copy finds the stars again."


@dataclass(frozen=True, eq=False)
class StoredView:
    """One pose as `views.h5` holds it."""

    view: View
    # (N, 2) float64, px, star found minus star projected by the run's calibration.
    residuals_px: NDArray[np.float64]
    # Reads its image, (H, W) uint8, grey values, when it is needed: a run may have a thousand. None without one.
    picture: Callable[[], NDArray[np.uint8]] | None = None

    def shown(self, *, pictured: bool = False) -> ViewPicture:
        """Return the pose as a report shows it, with its image if it is ``pictured``."""
        image = self.picture() if pictured and self.picture is not None else None
        view = self.view
        return ViewPicture(view.name, image, view.points_px, view.points_px - self.residuals_px, view.ids)


def views_file(views: Iterable[StoredView]) -> bytes:
    """Return views, residuals and images, where there are any, as an HDF5 file."""
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["format"] = FORMAT
        for number, stored in enumerate(views, 1):
            view, group = stored.view, file.create_group(_group_name(number))
            group.attrs["name"] = view.name
            group.attrs["image_size"] = view.image_size
            for name, values in arrays_of(view, {"residuals_px": stored.residuals_px}).items():
                group.create_dataset(name, data=values)
            if view.recorded_s is not None:
                group.attrs["recorded_s"] = view.recorded_s
            if view.rim is not None:
                group.attrs["rim_level_sigma_mm"] = view.rim.level_sigma_mm
            if stored.picture is not None:
                group.create_dataset("picture", data=stored.picture(), compression="gzip", compression_opts=4)
    return memory.getvalue()


def read_views(path: Path) -> list[StoredView]:
    """Read a `views.h5` in the order of its groups; recalculated results have no images."""
    with _opened(path) as file:
        pictured = all("picture" in group for group in file.values())
        return [
            _stored_view(member(file, _group_name(n)), partial(read_picture, path, n) if pictured else None)
            for n in range(1, len(file) + 1)
        ]


def read_picture(path: Path, number: int) -> NDArray[np.uint8]:
    """Read the image of a group from 1 of a `views.h5`: (H, W) uint8, grey values as the report shows them."""
    with _opened(path) as file:
        return np.asarray(_array(member(file, _group_name(number)), "picture"), np.uint8)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a `views.h5`: RunFolderError for every fault inside the block, StorageError if it is not there or denied."""
    try:
        with storage_errors(path):
            require_regular(path)
            path.open("rb").close()
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise RunFolderError(
                    f"The file does not have the format {FORMAT}.", where=str(path), remedy=_REMEDY
                )
            yield file
    except RecordingFileError as error:
        raise RunFolderError(error.what, where=str(path), remedy=_REMEDY) from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError, InputMismatch) as error:
        raise RunFolderError(f"The file cannot be read: {error}.", where=str(path), remedy=_REMEDY) from error


def _array(group: h5py.Group, name: str) -> NDArray[Any]:
    """Read an array that lies in the file itself, of a size that a view can have."""
    return whole(dataset(group, name), _MOST_BYTES)


def arrays_of(view: View, more: Mapping[str, NDArray[np.float64]] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of a view by name, with ``more`` of its stars."""
    arrays = {name: getattr(view, name) for name in _ARRAYS} | dict(more or {})
    if view.rim is None:
        return arrays
    return arrays | {f"rim_{name}": getattr(view.rim, name) for name in _RIM}


def view_of(
    name: str, size: Iterable[int], arrays: Callable[[str], NDArray[Any]], level_sigma_mm: float | None
) -> View:
    """Return the view of arrays by name; it has no rim without the uncertainty of its level."""
    rim = None
    if level_sigma_mm is not None:
        of_rim = {name: np.asarray(arrays(f"rim_{name}"), np.float64) for name in _RIM}
        rim = RimPoints(**of_rim, level_sigma_mm=float(level_sigma_mm))
    width, height = (int(side) for side in size)
    stars: dict[str, Any] = {name: np.asarray(arrays(name), kind) for name, kind in _ARRAYS.items()}
    return View(name=name, image_size=(width, height), rim=rim, **stars)


def _group_name(number: int) -> str:
    return f"pose-{number:03d}"


def _stored_view(group: h5py.Group, picture: Callable[[], NDArray[np.uint8]] | None) -> StoredView:
    # Files of earlier versions have no rim.
    level_sigma_mm = group.attrs["rim_level_sigma_mm"] if "rim_points_mm" in group else None
    view = view_of(
        str(group.attrs["name"]), group.attrs["image_size"], partial(_array, group), level_sigma_mm
    )
    residuals_px = np.asarray(_array(group, "residuals_px"), np.float64)
    if residuals_px.shape != view.points_px.shape:
        raise InputMismatch(
            f"{len(view)} stars, but residuals of shape {residuals_px.shape}", where=group.name
        )
    recorded_s = group.attrs.get("recorded_s")  # files of earlier versions have none
    if recorded_s is not None:
        view = replace(view, recorded_s=float(recorded_s))
    return StoredView(view, residuals_px, picture)
