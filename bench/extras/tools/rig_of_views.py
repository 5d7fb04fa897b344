"""The rig of two cameras from files: behind one collimator, at boards that both saw, or both."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import parse_json
from bench.base.errors import UsageError
from bench.camera_files.reader import CameraFile
from bench.camera_files.texts import OtherForm
from bench.record.storage import read_bounded
from bench.solve.exports import (
    NOT_WRITTEN,
    FormatCannotCarry,
    camera_info,
    file_storage_bytes,
    kalibr_camera,
    opencv_coefficients,
    yaml_bytes,
)
from bench.solve.loose_recordings import RECORDINGS
from bench.solve.offline import (
    Reached,
    calibrate_paths,
    nothing_shown,
    read_views,
    require_common_views,
    require_other_views,
)
from bench.solve.offline_options import OfflineOptions
from bench.solve.view_sources import left_beside, view_sources
from calib.model.rotation import exp_map, log_map
from calib.studies.clock_offset import ClockOffset, clock_offset, common_rate
from calib.studies.rig import Rig, stated_cameras, through_collimator
from calib.studies.rig_boards import with_boards
from calib.view import View
from drivers.camera.raw_file import RawFile

Pair = Sequence[Path]
Array = NDArray[np.float64]

_MOST_BYTES = 20_000_000  # Far above a file of two cameras
_FARTHEST_MM = 1e6  # A kilometre between two cameras is another unit
_LARGEST_VARIANCE = 1e12  # The square of the above

_NAMES = ("cam0", "cam1")


@dataclass(frozen=True)
class RigFound:
    """A rig, and the files that were left out, a sentence each."""

    rig: Rig
    skipped: tuple[str, ...]
    clocks: tuple[ClockOffset, ...] = ()  # Of each recording, if they were asked for

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and names, ready for JSON."""
        content = {**self.rig.to_dict(), "skipped": list(self.skipped)}
        if not self.clocks:
            return content
        rate, sigma = common_rate(self.clocks)
        every = [asdict(clock) for clock in self.clocks]
        return {**content, "clocks": {"rate_ppm": rate, "sigma_rate_ppm": sigma, "recordings": every}}


def find_rig(
    paths: Pair,
    boards: Pair,
    cameras: Sequence[CameraFile],
    choices: OfflineOptions,
    progress: Reached = nothing_shown,
) -> RigFound:
    """Return the rig of two cameras. Every argument has one entry for each camera, or none.

    ``paths`` are views behind a collimator, or of a board that `choices` names; ``boards`` views of that board beside
    them. ``progress`` is told how many views of all have been read.
    """
    reading = _Reading([*paths, *boards], choices, progress)
    if choices.board is None:
        if boards:
            raise UsageError(
                "--boards needs --board.", remedy="Say what the board is: --board checkerboard:11x7:20mm."
            )
        return _by_views(paths, choices, reading, cameras)
    if not boards:
        if cameras:
            return _by_cameras(paths, cameras, choices, reading)
        return _by_views(paths, choices, reading)
    require_common_views(boards[0], boards[1], choices)
    start = _by_views(paths, replace(choices, board=None, model=None), reading, cameras)
    seen, skipped = _board_views(boards, [choices, choices], reading)
    return RigFound(with_boards(start.rig, seen[0], seen[1], choices.board), (*start.skipped, *skipped))


class _Reading:
    """Counts the views of several paths, which are read one after another, as one work."""

    def __init__(self, paths: Sequence[Path], choices: OfflineOptions, progress: Reached) -> None:
        self._paths, self._choices = paths, choices
        self._before, self._progress = 0, progress

    @cached_property
    def _total(self) -> int:
        return sum(len(list(view_sources(path, self._choices))) for path in self._paths)

    def reached(self, done: int, of_path: int) -> None:
        """Tell that so many views of the present path are read."""
        self._progress(min(self._before + done, self._total), self._total)
        if done == of_path:
            self._before += of_path


def _by_views(
    paths: Pair, choices: OfflineOptions, reading: _Reading, cameras: Sequence[CameraFile] = ()
) -> RigFound:
    """Return the rig by views that give the intrinsics too; `cameras` add what is known of them from other views."""
    require_common_views(paths[0], paths[1], choices)
    for path, own in zip(paths, cameras, strict=bool(cameras)):
        require_other_views(own.path, [path])
    results = [calibrate_paths([path], choices, progress=reading.reached) for path in paths]
    skipped = tuple(reason for result in results for reason in result.skipped)
    first, second = (result.calibration for result in results)
    if all(result.board for result in results):
        start = stated_cameras(first.camera, second.camera)
        return RigFound(
            with_boards(start, results[0].views, results[1].views, results[0].board, free=True), skipped
        )
    known = [(camera.camera, camera.covariance) for camera in cameras] or (None, None)
    return RigFound(through_collimator(first, second, known), skipped)


def _by_cameras(
    paths: Pair, stated: Sequence[CameraFile], choices: OfflineOptions, reading: _Reading
) -> RigFound:
    """Return the rig by boards, with the intrinsics of files."""
    require_common_views(paths[0], paths[1], choices)
    seen, skipped = _board_views(paths, [_sized(choices, stated_camera) for stated_camera in stated], reading)
    start = stated_cameras(
        stated[0].camera, stated[1].camera, [stated_camera.covariance for stated_camera in stated]
    )
    return RigFound(with_boards(start, seen[0], seen[1], choices.board), tuple(skipped))


def _sized(choices: OfflineOptions, stated: CameraFile) -> OfflineOptions:
    return choices if choices.image_size else replace(choices, image_size=stated.camera.image_size)


def _board_views(
    paths: Pair, choices: Sequence[OfflineOptions], reading: _Reading
) -> tuple[list[list[View]], list[str]]:
    read = [
        read_views(list(view_sources(path, own)), reading.reached)
        for path, own in zip(paths, choices, strict=True)
    ]
    left = [sentence for path in paths for sentence in left_beside(path)]
    return [views for views, *_ in read], [reason for *_, skipped in read for reason in skipped] + left


def find_clocks(folders: Sequence[Pair], choices: OfflineOptions) -> tuple[ClockOffset, ...]:
    """Return offset and rate of the second camera's clock in each recording that both cameras made."""
    clocks = []
    for pair in folders:
        first, second = (
            {source.name: source.path for source in view_sources(path, choices)} for path in pair
        )
        common = [name for name in first if name in second]
        clocks += [clock_offset(name, *(_rising_us(own[name]) for own in (first, second))) for name in common]
    return tuple(clocks)


def _rising_us(path: Path) -> list[int]:
    if path.suffix.lower() not in RECORDINGS:
        raise UsageError(
            "Sync edges stand in RAW recordings only.",
            where=str(path),
            remedy="Leave out --sync, or give the recordings of both cameras.",
        )
    edges = RawFile.open(path).triggers()
    return list(map(int, edges.t[edges.value == 1]))


class NotARig(UsageError):
    """A file does not hold one rig of two cameras that can be read."""


@dataclass(frozen=True)
class StatedRig:
    """A rig as a file states it: X_second = rotation X_first + translation."""

    rotation: Array  # (3, 3)
    translation_mm: Array | None  # (3,)
    # (6, 6) of rotation vector on the second camera's side, rad, and translation, mm; (3, 3) without translation.
    covariance: Array | None


def read_rig_file(path: Path) -> StatedRig:
    """Read the rig of a file, which must hold exactly one."""
    try:
        content = parse_json(read_bounded(path, _MOST_BYTES))
        stated = _of_sdk(content) if "T_slave_master" in content else _own(content)
        _require_possible(stated)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        why = str(error) if isinstance(error, OtherForm) else "a value has another form"
        why = f"it has no {error}" if isinstance(error, KeyError) else why
        raise NotARig(
            f"This file does not hold a rig: {why}.",
            where=str(path),
            remedy="Known are rig.json of this command, and extrinsics.json of the Metavision SDK.",
        ) from error
    return stated


def _of_sdk(content: Any) -> StatedRig:
    entries = content["T_slave_master"]
    if len(entries) != 1:
        raise OtherForm(f"it states {len(entries)} cameras beside the master, not one")
    turn = np.array(entries[0]["rvec"], np.float64).reshape(3)
    return StatedRig(
        exp_map(turn[None])[0], 1000.0 * np.array(entries[0]["tvec"], np.float64).reshape(3), None
    )


def _own(content: Any) -> StatedRig:
    turn = np.deg2rad(np.array(content["vector_deg"], np.float64).reshape(3))
    moved = content["translation"]
    size = 3 if moved is None else 6
    return StatedRig(
        exp_map(turn[None])[0],
        None if moved is None else np.array(moved, np.float64).reshape(3),
        np.array(content["pose_covariance"], np.float64).reshape(size, size),
    )


def _require_possible(stated: StatedRig) -> None:
    if not np.isfinite(stated.rotation).all():
        raise OtherForm("its rotation is not finite")
    moved = stated.translation_mm
    if moved is not None and not (np.abs(moved) <= _FARTHEST_MM).all():
        raise OtherForm("its translation is not a distance on a rig")
    known = stated.covariance
    if known is not None and not (
        (np.abs(known) <= _LARGEST_VARIANCE).all() and np.linalg.eigvalsh(known)[0] >= -1e-9 * np.trace(known)
    ):
        raise OtherForm("its covariance is impossible")


def rig_exports(rig: Rig, content: Mapping[str, Any]) -> dict[str, bytes]:
    """Return file name to content, for a rig with a translation; ``not-written.txt`` says what is missing and why."""
    files = {
        "rig.json": (json.dumps(content, indent=2, allow_nan=False) + "\n").encode(),
        "extrinsics.json": _extrinsics(rig),
    }
    refused = []
    for name, write in {"kalibr_camchain.yaml": _camchain, "stereo": _stereo}.items():
        try:
            files |= write(rig)
        except FormatCannotCarry as refusal:
            refused.append(f"{name}: {refusal}\n")
    if refused:
        files[NOT_WRITTEN] = "".join(refused).encode()
    return files


def _metres(rig: Rig) -> Array:
    assert rig.translation_mm is not None
    return rig.translation_mm / 1000.0


def _extrinsics(rig: Rig) -> bytes:
    """Write the extrinsics.json of Metavision SDK 5: the slave's pose for a point of the master."""
    extrinsics = {
        "camera": _NAMES[1],
        "rvec": log_map(rig.rotation[None])[0].tolist(),
        "tvec": _metres(rig).tolist(),
    }
    return (json.dumps({"T_slave_master": [extrinsics]}, indent=4) + "\n").encode()


def _camchain(rig: Rig) -> dict[str, bytes]:
    """Write Kalibr's camchain; ``T_cn_cnm1`` takes points of the camera before to this one."""
    remarks, chain = b"", {}
    for name, camera in zip(_NAMES, (rig.first, rig.second), strict=True):
        remark, chain[name] = kalibr_camera(camera, name)
        remarks += remark
        chain[name]["cam_overlaps"] = [1 - _NAMES.index(name)]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rig.rotation, _metres(rig)
    chain[_NAMES[1]]["T_cn_cnm1"] = pose.tolist()
    return {"kalibr_camchain.yaml": remarks + yaml_bytes(chain)}


def _stereo(rig: Rig) -> dict[str, bytes]:
    """Write the pair of ROS's camera_info, and OpenCV's stereo file, with the rectification that both share."""
    first, second = rig.first, rig.second
    if first.image_size != second.image_size or first.is_fisheye != second.is_fisheye:
        raise FormatCannotCarry(
            "A rectified pair needs two cameras with images of one size and lenses of one family.",
            remedy="Use kalibr_camchain.yaml or extrinsics.json.",
        )
    lenses = [opencv_coefficients(camera) for camera in (first, second)]
    inputs = (first.matrix, lenses[0], second.matrix, lenses[1], first.image_size, rig.rotation)
    place = 1000.0 * _metres(rig)[:, None]
    if first.is_fisheye:
        r1, r2, p1, p2, q = cv2.fisheye.stereoRectify(*inputs, place, cv2.CALIB_ZERO_DISPARITY)
    else:
        r1, r2, p1, p2, q, *_ = cv2.stereoRectify(*inputs, place, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1)
    metres = np.diag([1.0, 1.0, 1.0, 1e-3])
    pair = zip(_NAMES, (first, second), (r1, r2), (p1 @ metres, p2 @ metres), strict=True)
    files = {
        f"{name}_camera_info.yaml": camera_info(camera, name, projection, turn)
        for name, camera, turn, projection in pair
    }
    content = {
        "image_width": first.image_size[0],
        "image_height": first.image_size[1],
        "fisheye_model": int(first.is_fisheye),
        "M1": first.matrix,
        "D1": lenses[0][None],
        "M2": second.matrix,
        "D2": lenses[1][None],
        "R": rig.rotation,
        "T": place,
        "R1": r1,
        "R2": r2,
        "P1": p1,
        "P2": p2,
        "Q": q,
        "pose_covariance": rig.pose_covariance,
    }
    return {**files, "opencv_stereo.yaml": file_storage_bytes(".yml", content)}
