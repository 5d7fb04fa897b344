"""The rig of two cameras from files: behind one collimator, at boards that both saw, or both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.plan.camera_files import CameraFile, read_camera_file
from bench.results.offline import calibrate_paths, read_views, require_common_views
from bench.results.offline_options import OfflineOptions
from bench.results.view_sources import RECORDINGS, ViewSource, view_sources
from calib.studies.clock_offset import ClockOffset, clock_offset, common_rate
from calib.studies.rig import Rig, stated_cameras, through_collimator, with_boards
from calib.view import View
from drivers.camera.raw_file import RawFile

Pair = Sequence[Path]


@dataclass(frozen=True)
class RigFound:
    """A rig, and the files that were left out, a sentence each."""

    rig: Rig
    skipped: tuple[str, ...]
    clocks: tuple[ClockOffset, ...] = ()  # Of each recording, if they were asked for

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and names, ready for JSON."""
        told = {**self.rig.to_dict(), "skipped": list(self.skipped)}
        if not self.clocks:
            return told
        rate, sigma = common_rate(self.clocks)
        every = [one.to_dict() for one in self.clocks]
        return {
            **told,
            "clocks": {"rate_ppm": 1e6 * rate, "sigma_rate_ppm": 1e6 * sigma, "recordings": every},
        }


def find_rig(paths: Pair, boards: Pair, cameras: Pair, choices: OfflineOptions) -> RigFound:
    """Return the rig of two cameras. Every argument has one entry for each camera, or none.

    paths: Views behind a collimator; or of a board, if `choices` names one and `boards` is empty.
    boards: Views of the board beside those behind the collimator.
    cameras: Files with the intrinsics from other views.
    """
    if choices.board is None:
        if boards:
            raise UsageError(
                "--boards needs --board.", remedy="Say what the board is: --board checkerboard:11x7:20mm."
            )
        return _by_views(paths, choices, cameras)
    if not boards:
        return _by_cameras(paths, cameras, choices) if cameras else _by_views(paths, choices)
    require_common_views(boards[0], boards[1], choices)
    start = _by_views(paths, replace(choices, board=None, model=None), cameras)
    seen, skipped = _board_views(boards, [choices, choices])
    return RigFound(with_boards(start.rig, *seen), (*start.skipped, *skipped))


def _by_views(paths: Pair, choices: OfflineOptions, cameras: Pair = ()) -> RigFound:
    """Return the rig by views that give the intrinsics too; `cameras` add what is known of them from other views."""
    require_common_views(paths[0], paths[1], choices)
    stated = [read_camera_file(file) for file in cameras]
    for path, own in zip(paths, stated, strict=bool(stated)):
        if own.path.resolve().is_relative_to(path.resolve()):
            raise UsageError(
                "This calibration was made from the same views. They would count twice.",
                where=str(own.path),
                remedy="Give a calibration from other views, or leave out --calibration.",
            )
    results = [calibrate_paths([path], choices) for path in paths]
    skipped = tuple(reason for result in results for reason in result.skipped)
    first, second = (result.calibration for result in results)
    if all(result.board for result in results):
        start = stated_cameras(first.camera, second.camera)
        return RigFound(with_boards(start, results[0].views, results[1].views, free=True), skipped)
    known = [(one.camera, one.covariance) for one in stated] or (None, None)
    return RigFound(through_collimator(first, second, known), skipped)


def _by_cameras(paths: Pair, cameras: Pair, choices: OfflineOptions) -> RigFound:
    """Return the rig by boards, with the intrinsics of files."""
    require_common_views(paths[0], paths[1], choices)
    stated = [read_camera_file(file) for file in cameras]
    seen, skipped = _board_views(paths, [_sized(choices, one) for one in stated])
    start = stated_cameras(stated[0].camera, stated[1].camera, [one.covariance for one in stated])
    return RigFound(with_boards(start, *seen), tuple(skipped))


def _sized(choices: OfflineOptions, stated: CameraFile) -> OfflineOptions:
    return choices if choices.image_size else replace(choices, image_size=stated.camera.image_size)


def _board_views(paths: Pair, choices: Sequence[OfflineOptions]) -> tuple[list[list[View]], list[str]]:
    found = [read_views(list(view_sources(path, own))) for path, own in zip(paths, choices, strict=True)]
    return [views for views, *_ in found], [reason for *_, skipped in found for reason in skipped]


def find_clocks(folders: Sequence[Pair], choices: OfflineOptions) -> tuple[ClockOffset, ...]:
    """Return offset and rate of the second camera's clock in each recording that both cameras made.

    folders: Pairs of paths, an entry for each camera.
    """
    clocks = []
    for pair in folders:
        first, second = ({source.name: source.path for source in _chosen(path, choices)} for path in pair)
        common = [name for name in first if name in second]
        clocks += [clock_offset(name, *(_rising_us(own[name]) for own in (first, second))) for name in common]
    return tuple(clocks)


def _chosen(path: Path, choices: OfflineOptions) -> list[ViewSource]:
    sources = list(view_sources(path, choices))
    numbers = choices.view_numbers or range(1, len(sources) + 1)
    return [sources[number - 1] for number in numbers if number <= len(sources)]


def _rising_us(path: Path) -> list[int]:
    if path.suffix.lower() not in RECORDINGS:
        raise UsageError(
            "Sync edges stand in RAW recordings only.",
            where=str(path),
            remedy="Leave out --sync, or give the recordings of both cameras.",
        )
    edges = RawFile.open(path).triggers()
    return list(map(int, edges.t[edges.value == 1]))
