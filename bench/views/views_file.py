"""`views.h5`: stars, residuals and image of each calibrated pose (layout: docs/run-folder.md); written and read."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import RunFolderError
from calib.errors import InputMismatch
from calib.view import RimPoints, View
from drivers.camera.formats.hdf5_reading import dataset, member, whole
from drivers.camera.raw_writer import require_regular
from drivers.errors import NotARecording

VIEWS = "views.h5"
FORMAT = "starbench/views/1"

_MOST_BYTES = 1 << 30
_REMEDY = "Delete the file; `starbench.load` then finds the stars again in the captures."


@dataclass(frozen=True, eq=False)
class StoredView:
    """One pose as `views.h5` holds it, without its image."""

    view: View
    # (N, 2) float64, px, star found minus star projected by the run's calibration.
    residuals_px: NDArray[np.float64]


class Pictured(Protocol):
    """An image that can be decoded, as `bench.views.measure.StoredImage`."""

    def decoded(self) -> NDArray[np.uint8]:
        """Return the image: (H, W) uint8, grey values."""
        ...


class Measured(Protocol):
    """A view with its image, as `bench.views.measure.Measurement`."""

    @property
    def view(self) -> View | None:
        """The stars."""

    @property
    def image(self) -> Pictured | None:
        """The image."""


def views_file(
    measurements: Sequence[Measured],
    residuals_px: Sequence[NDArray[np.float64]],
) -> bytes:
    """Return views, residuals ((N, 2), found minus projected) and images, where there are any, as an HDF5 file."""
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["format"] = FORMAT
        for number, (found, residuals) in enumerate(zip(measurements, residuals_px, strict=True), 1):
            view = found.view
            assert view is not None
            group = file.create_group(_group_name(number))
            group.attrs["name"] = view.name
            group.attrs["image_size"] = view.image_size
            for name in ("ids", "points_px", "target_mm", "covariances_px2"):
                group.create_dataset(name, data=getattr(view, name))
            group.create_dataset("residuals_px", data=residuals)
            if view.rim is not None:
                _write_rim(group, view.rim)
            if found.image is not None:
                group.create_dataset(
                    "picture", data=found.image.decoded(), compression="gzip", compression_opts=4
                )
    return memory.getvalue()


def read_views(path: Path) -> list[StoredView]:
    """Read the views and residuals of a `views.h5`, in the order of its groups, without images (`read_picture`)."""
    with _opened(path) as file:
        return [_stored_view(member(file, _group_name(number))) for number in range(1, len(file) + 1)]


def has_pictures(path: Path) -> bool:
    """Return whether a `views.h5` holds the images of the poses; views of recalculated results have none."""
    with _opened(path) as file:
        return all("picture" in group for group in file.values())


def read_picture(path: Path, number: int) -> NDArray[np.uint8]:
    """Read the image of a group from 1 of a `views.h5`: (H, W) uint8, grey values as the report shows them."""
    with _opened(path) as file:
        return np.asarray(_array(member(file, _group_name(number)), "picture"), np.uint8)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a `views.h5` for reading; every fault inside the block becomes a RunFolderError."""
    try:
        require_regular(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise RunFolderError(
                    f"The file does not have the format {FORMAT}.", where=str(path), remedy=_REMEDY
                )
            yield file
    except NotARecording as error:
        raise RunFolderError(error.what, where=str(path), remedy=_REMEDY) from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError, InputMismatch) as error:
        raise RunFolderError(f"The file cannot be read: {error}.", where=str(path), remedy=_REMEDY) from error


def _array(group: h5py.Group, name: str) -> NDArray[Any]:
    """Read an array that lies in the file itself, of a size that a view can have."""
    return whole(dataset(group, name), _MOST_BYTES)


def _write_rim(group: h5py.Group, rim: RimPoints) -> None:
    for name, values in (
        ("rim_points_mm", rim.points_mm),
        ("rim_sigmas_mm", rim.sigmas_mm),
        ("rim_lit_mm", rim.lit_mm),
    ):
        group.create_dataset(name, data=values)
    group.attrs["rim_level_sigma_mm"] = rim.level_sigma_mm


def _read_rim(group: h5py.Group) -> RimPoints | None:
    """Read the rim; None if the image was not searched for it, as in files of earlier versions."""
    if "rim_points_mm" not in group:
        return None
    return RimPoints(
        points_mm=np.asarray(_array(group, "rim_points_mm"), np.float64),
        sigmas_mm=np.asarray(_array(group, "rim_sigmas_mm"), np.float64),
        lit_mm=np.asarray(_array(group, "rim_lit_mm"), np.float64),
        level_sigma_mm=float(group.attrs["rim_level_sigma_mm"]),
    )


def _group_name(number: int) -> str:
    return f"pose-{number:03d}"


def _stored_view(group: h5py.Group) -> StoredView:
    width, height = (int(side) for side in group.attrs["image_size"])
    view = View(
        name=str(group.attrs["name"]),
        image_size=(width, height),
        ids=np.asarray(_array(group, "ids"), np.int64),
        points_px=np.asarray(_array(group, "points_px"), np.float64),
        target_mm=np.asarray(_array(group, "target_mm"), np.float64),
        covariances_px2=np.asarray(_array(group, "covariances_px2"), np.float64),
        rim=_read_rim(group),
    )
    residuals_px = np.asarray(_array(group, "residuals_px"), np.float64)
    if residuals_px.shape != view.points_px.shape:
        raise InputMismatch(
            f"{len(view)} stars, but residuals of shape {residuals_px.shape}", where=group.name
        )
    return StoredView(view, residuals_px)
