"""Event images of one pose: each kind gathers whole periods of the flicker in its own way.

The input is arrays of events and a `Flicker`; the module reads no file and does not use the target. All images are
brighter where the target is brighter. The kinds are:

last polarity
    +1, -1 or 0: the polarity of a pixel's last event. arXiv:2512.16092 too maps polarities to pixel values, within
    33 ms. A single stray event changes this image.
count
    Number of events of a pixel.
fired-per-edge
    Share of the light's edges on which the pixel fired within the burst; an edge counts once, however many events
    it makes. Best if a pixel sends one or two events an edge, because the readout decides how many more it sends.
lock-in
    Sum of p cos(2 pi (t - t0) / T) over the events, with polarity p = +-1, period T, and t0 at the phase at which the
    whole image responds most strongly (synchronous detection). Best if pixels send several events an edge, because
    their number then carries grey levels.
first-ON latency
    Mean time from the start of the ON burst to the pixel's first ON event of the burst.

The image of a live picture is made from the number of events of each pixel and polarity in whole periods alone: fired
per edge is then the number of events a period, 1 at most, and events per edge stand in place of lock-in.

Whether the camera stood still is shown by the stars of both halves of a window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array32, Bools, Bytes, Ints
from calib.errors import InputMismatch, TooFewEvents, placed
from calib.events.accumulation import (
    BurstWindow,
    Halves,
    PixelSums,
    accumulate,
    hot_pixels,
    require_inside,
    whole_period_window,
    without_hot_pixels,
)
from calib.events.event_times import EventTimes, event_times
from calib.events.flicker import Flicker
from calib.events.silent_lines import SilentLines

#: Least number of events an edge for the lock-in image; below it, fired-per-edge is used. Simulated, a square flicker
#: gives 1.1 to 1.2, whose number tells nothing, and a bright sine 4.1 to 4.5 (docs/measured/stars.md).
LOCK_IN_MIN_EVENTS = 1.9
#: Least share of the edges on which a lit pixel fires: noise alone, or the border of the light, makes fewer.
LIT_SHARE = 0.75
#: Shift between the halves from which a pose counts as moving, px. Repeated recordings of a pose at rest differ by
#: 0.006 to 0.02 px a star, and far less in the mean.
MOVING_PX = 0.05


class ChosenImage(NamedTuple):
    """The image in which stars are searched."""

    name: str  # Kind of image, as `EventImages.named` takes it
    image: Array32  # (H, W) float32, brighter where the target is brighter
    reason: str  # Why this kind was chosen, a phrase or sentence for the report


@dataclass(frozen=True)
class SliceFacts:
    """Properties of a slice of events; gates and reports use them."""

    start_us: float  # Start of the window used, us; the window has whole periods
    end_us: float  # End of the window used, us
    periods: int
    on_share: float
    lit_pixels: int  # Number of pixels that fire on at least the share `LIT_SHARE` of the edges
    events_per_edge: float
    events_per_edge_on: float
    events_per_edge_off: float
    # Standard deviation over the lit pixels of the latency of the first ON event, us. It is large if the
    # readout is saturated.
    first_on_spread_us: float
    hot_pixels: int  # Number of pixels masked because they fire far more often than their surroundings
    # Numbers of rows and columns without any event between those with lit pixels.
    silent_rows: int
    silent_columns: int


@dataclass(frozen=True)
class EventImages:
    """Images of one pose, all (H, W), and the facts of their slice of events."""

    sums: PixelSums
    # bool, pixels that fire far more often than their surroundings. `best` and most images of `named` replace
    # them by the median of their surroundings.
    hot: Bools
    window: tuple[float, float, int]  # Start and end, us, and number of periods
    on_window: BurstWindow
    _fired_in_halves: Halves | None

    @cached_property
    def _lit(self) -> Bools:
        """(H, W), the pixels that fire on at least the share `LIT_SHARE` of the edges; hot ones are none."""
        least = LIT_SHARE * self.window[2]
        return np.asarray((self.sums.on_fired >= least) & (self.sums.off_fired >= least) & ~self.hot)

    @cached_property
    def silent(self) -> SilentLines:
        """Rows and columns that `named` and `halves` interpolate."""
        return SilentLines.of((self.sums.on_count > 0) | (self.sums.off_count > 0), self._lit)

    @cached_property
    def facts(self) -> SliceFacts:
        """Properties of the slice."""
        sums, lit, (start, end, periods) = self.sums, self._lit, self.window
        latency_us, number = sums.mean_latency_us()[lit], int(np.count_nonzero(lit))
        counts = (int(count[lit].sum()) for count in (sums.on_count, sums.off_count))
        on, off = (float(count) / number / periods if number else 0.0 for count in counts)
        on_events = int(sums.on_count.sum())
        return SliceFacts(
            start_us=start,
            end_us=end,
            periods=periods,
            on_share=on_events / (on_events + int(sums.off_count.sum())),
            lit_pixels=number,
            events_per_edge=(on + off) / 2.0,
            events_per_edge_on=on,
            events_per_edge_off=off,
            first_on_spread_us=float(latency_us.std()) if number else float("nan"),
            hot_pixels=int(np.count_nonzero(self.hot)),
            silent_rows=len(self.silent.rows),
            silent_columns=len(self.silent.columns),
        )

    @cached_property
    def fired_per_edge(self) -> Array32:
        """(H, W) float32, 0 to 1, share of the edges on which the pixel fired; hot pixels are replaced."""
        edges = 2.0 * self.window[2]
        share = (self.sums.on_fired.astype(np.float32) + self.sums.off_fired) / np.float32(edges)
        return without_hot_pixels(share, self.hot)

    @property
    def halves(self) -> tuple[Bytes, Bytes] | None:
        """Share of the edges of each half of the window on which a pixel fired, (H, W) uint8, 0 to 255, for motion.

        Hot pixels are replaced. None if the window holds one period.
        """
        if self._fired_in_halves is None:
            return None
        scale = 255.0 / (2 * (self.window[2] // 2))
        shares = (
            np.asarray(cv2.convertScaleAbs(each, alpha=scale), np.uint8) for each in self._fired_in_halves
        )
        first, second = (self.silent.filled(without_hot_pixels(share, self.hot)) for share in shares)
        return first, second

    def best(self, *, one_phase: bool = True) -> ChosenImage:
        """Choose the kind of image in which stars are found best, by a lit pixel's events an edge; without hot pixels.

        Lock-in from `LOCK_IN_MIN_EVENTS` events an edge on, fired-per-edge below. If the lines of a screen change one
        after the other (no ``one_phase``), the lock-in sum is smaller where they change early or late, and this slope
        displaces edges: count is used instead.
        """
        name, least = "lock-in" if one_phase else "count", LOCK_IN_MIN_EVENTS
        why = f", {least} or more: their number carries grey levels."
        if self.facts.events_per_edge < least:
            name, why = "fired-per-edge", f", fewer than {least}: only whether a pixel fired is reliable."
        elif not one_phase:
            why = "; no sync edges show that all pixels change at once."
        reason = f"{self.facts.events_per_edge:.2f} events per edge{why}"
        return ChosenImage(name, self.named(name), reason)

    def named(self, name: str) -> Array32:
        """Return the (H, W) image of one kind, brighter where the target is brighter.

        Names: ``last-polarity``, ``any``, ``count``, ``fired-per-edge``, ``lock-in`` and ``on-latency``. The latter is
        1 minus the latency in units of the burst's length, and 0 where no ON event came.
        """
        sums = self.sums
        makers = {
            "last-polarity": lambda: sums.last_polarity.astype(np.float32),
            "any": lambda: (sums.last_polarity != 0).astype(np.float32),
            "count": lambda: without_hot_pixels(
                (sums.on_count + sums.off_count).astype(np.float32), self.hot
            ),
            "fired-per-edge": lambda: self.fired_per_edge,
            "lock-in": lambda: without_hot_pixels(sums.lock_in, self.hot),
            "on-latency": self._inverted_latency,
        }
        if name not in makers:
            raise InputMismatch(f"No event image is called {name!r}. The kinds are {', '.join(makers)}.")
        return self.silent.filled(makers[name]())

    def _inverted_latency(self) -> Array32:
        length, latency_us = np.float32(self.on_window.length_us), self.sums.mean_latency_us()
        return np.where(np.isnan(latency_us), np.float32(0), 1.0 - latency_us / length)


def make_images(
    t: Ints,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: Bytes,
    size: tuple[int, int],
    flicker: Flicker,
    *,
    window_us: tuple[float, float] | None = None,
    periods: int | None = None,
    times: EventTimes | None = None,
) -> EventImages:
    """Make the images of the events of whole flicker periods.

    The head of the module gives the equations. Polarities as pixel values: arXiv:2512.16092. Lock-in: Meade (1983). The
    other kinds are this project's own.

    Parameters
    ----------
    t
        (N,) int64, times of the events, us, in ascending order.
    x, y
        (N,) uint16, columns and rows, px.
    p
        (N,) uint8, polarities: 1 is ON, 0 is OFF.
    size
        Width and height of the sensor, px.
    flicker
        Period and phase of the light on the same clock.
    window_us
        Start and end of the recording, us; by default the first and the last event. That is shorter than the
        recording if few events come between the bursts.
    periods
        Number of periods to use; by default as many whole periods as the window holds.
    times
        The events by their time, if they are known already.

    Returns
    -------
    EventImages
        All kinds of images, (H, W), and the facts of the slice.

    Raises
    ------
    TooFewEvents
        If the window holds no events, or fewer whole periods than needed.
    InputMismatch
        If the arrays differ in length, or an event lies outside of the sensor.
    """
    with placed("event image"):
        if not t.shape == x.shape == y.shape == p.shape:
            raise InputMismatch(
                f"The arrays of events differ in length: {t.size} times, {x.size} columns, {y.size} rows, "
                f"{p.size} polarities."
            )
        require_inside(x, y, size)
        start, end, whole = whole_period_window(t, flicker, window_us, periods)
        inside = (event_times(t, p) if times is None else times).between(start, end)
        if not len(inside.t):
            raise TooFewEvents(
                f"No event lies between {start:.0f} and {end:.0f} us.", remedy="Check light and aperture."
            )
    window = start, end, whole
    sums, halves, on_window = accumulate(inside, (t, x, y, p), size, window, flicker.period_us)
    hot = hot_pixels(sums.on_count, sums.off_count, 4 + 4 * whole)
    return EventImages(sums, hot, window, on_window, halves)


class QuickImage(NamedTuple):
    """Image by counts."""

    name: str  # ``fired-per-edge`` or ``events-per-edge``
    # (H, W) float32, brighter where the target is brighter; hot pixels are replaced.
    image: Array32
    hot_pixels: int  # Number of pixels that fire far more often than their surroundings


def make_quick_image(counts: NDArray[np.uint16], periods: int) -> QuickImage:
    """Make the image in which stars of a live picture are searched; kinds are those of `calib.events.event_image`.

    ``counts`` are (2, H, W) OFF events, then ON events, in at least one whole period. All 0 without events.
    """
    off, on = counts
    total = cv2.convertScaleAbs(cv2.add(on, off))  # at most 255
    levels = np.arange(256)
    limits = np.minimum(2.5 * levels + 4.0 + 4.0 * periods, 255.0).astype(np.uint8)
    hot = cv2.compare(total, cv2.LUT(cv2.medianBlur(total, 5), limits), cv2.CMP_GT)
    least = LIT_SHARE * periods
    lit = ((on >= least) & (off >= least) & (hot == 0)).view(np.uint8)
    per_edge = (cv2.mean(on, mask=lit)[0] + cv2.mean(off, mask=lit)[0]) / (2.0 * periods)
    name = "events-per-edge" if per_edge >= LOCK_IN_MIN_EVENTS else "fired-per-edge"
    if name == "fired-per-edge":
        on, off = (np.minimum(part, np.uint16(periods)) for part in (on, off))
    image = cv2.add(on, off).astype(np.float32)
    image *= np.float32(0.5 / periods)
    hot_pixels = cv2.countNonZero(hot)
    if hot_pixels:
        cv2.copyTo(cv2.medianBlur(image, 3), hot, image)
    return QuickImage(name, image, hot_pixels)
