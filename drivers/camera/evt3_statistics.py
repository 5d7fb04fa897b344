"""What the EVT3 decoder has counted in a stream: events, times, losses and gaps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StreamStatistics:
    """Counts, times and losses of a stream up to its last word."""

    events: int
    on_events: int
    triggers: int
    # first_t_us, last_t_us: The sensor's clock at its first and its last time word, us; both -1 before any
    # time word.
    first_t_us: int
    last_t_us: int
    # rate_controller_in, rate_controller_out: Number of events into and out of the rate controller, summed
    # over its windows of 200 us; None if the sensor sent no report.
    rate_controller_in: int | None
    rate_controller_out: int | None
    # Number of events that the sensor counted in its windows and that did not arrive; 0 without reports.
    lost_events: int
    # Number of windows in which the sensor's count differs from the number of events that arrived; 0 without
    # reports.
    mismatched_windows: int
    # Number of windows whose report did not arrive. It is not known how many events the sensor sent in them,
    # so ``lost_events`` is then a lower bound.
    missing_windows: int
    # The clock before and after each step of TIME_HIGH by more than one, us: words are missing there. The
    # first 64.
    gaps: tuple[tuple[int, int], ...]
    gap_count: int
    # Number of events before the first time, row or vector base: the stream began in the middle of another
    # one.
    unplaced_events: int
    back_steps: int

    @property
    def duration_s(self) -> float:
        """Time on the sensor's clock from the first time word to the last, s; 0 without time words."""
        return (self.last_t_us - self.first_t_us) * 1e-6 if self.first_t_us >= 0 else 0.0

    def loss_messages(self) -> tuple[str, ...]:
        """Describe each gap, and the losses that the sensor's own counts show.

        Returns: Sentences for the operator; none if nothing was lost.
        """
        messages = [f"Words are missing from {a} to {b} us of the sensor's clock." for a, b in self.gaps]
        if self.gap_count > len(self.gaps):
            messages.append(f"{self.gap_count - len(self.gaps)} more gaps follow.")
        if self.missing_windows:
            messages.append(
                f"{self.missing_windows} event count reports of the sensor are missing (it sends one every 200 us): "
                f"at least {self.lost_events} events are lost, and all events sent in these "
                f"{self.missing_windows * 0.2:.1f} ms."
            )
        elif self.mismatched_windows:
            messages.append(
                f"In {self.mismatched_windows} windows of 200 us the number of events that arrived differs from the "
                f"sensor's count: {self.lost_events} events are missing."
            )
        return tuple(messages)
