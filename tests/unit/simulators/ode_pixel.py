"""A pixel of an event sensor, solved step by step: slow, and independent of the simulator's closed forms."""

import numpy as np
from numba import njit


@njit
def solve_step_by_step(
    light, period, phase_us, shape, low, high, duty, ambient, q, on, off, dead, begin, end
):
    """du/dt = (1 - I u) / q in steps of 0.02 us; events of one pixel from ``begin`` (a reset) to ``end``.

    Without a dead time the first reference is the darkest level of the period before ``begin``, and each event
    moves it by exactly its threshold.

    Crossings and new references are interpolated within a step: in the flat tail of an edge an event's time
    answers to 1e-5 of the reference with a microsecond.
    """
    step = 0.02
    begin_t, live = begin - 4 * period, begin
    v = np.log(ambient + light * low)
    u = np.exp(-v)
    reference, waiting, darkest = 0.0, True, 1e9
    times, polarities = [0.0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(int((end - begin_t) / step)):
        t = begin_t + i * step  # at the step's end: t + step
        share = ((t + 0.5 * step + phase_us) / period) % 1.0
        if shape == 0:
            w = high if share < duty else low
        else:
            w = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2.0 * np.pi * share)
        intensity = ambient + light * w
        middle = u + 0.5 * step * (1.0 - intensity * u) / q
        u += step * (1.0 - intensity * middle) / q  # midpoint rule
        before, v = v, -np.log(u)
        if t > begin - period:
            darkest = min(darkest, v)
        if t + step < live:
            continue
        if waiting and dead == 0.0:
            reference, waiting = darkest, False
        if waiting:
            reference, waiting = before + (v - before) * (live - t) / step, False
        if v - reference >= on or reference - v >= off:
            level = reference + on if v > reference else reference - off
            times.append(t + step * (level - before) / (v - before))
            polarities.append(1 if v > reference else 0)
            live, waiting = times[-1] + dead, True
            if dead == 0.0:
                reference, waiting = level, False
    return times, polarities


@njit
def solve_with_filters(
    light, period, phase_us, low, high, duty, ambient, q, follower, corner, on, off, dead, end
):
    """As above under a square light, with the follower's low-pass and the high-pass behind the photoreceptor.

    In steps of 0.1 us; from 12 periods before 0, of which the last two have events, to ``end``.
    """
    step = 0.1
    begin_t, begin = -12.0 * period, -2.0 * period
    u, live = 1.0 / (ambient + light * low), begin
    followed = slow = -np.log(u)
    v, reference, waiting = 0.0, 0.0, True
    times, polarities = [0.0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(int((end - begin_t) / step)):
        t = begin_t + i * step
        share = ((t + 0.5 * step + phase_us) / period) % 1.0
        intensity = ambient + light * (high if share < duty else low)
        middle = u + 0.5 * step * (1.0 - intensity * u) / q
        was = -np.log(middle)
        u += step * (1.0 - intensity * middle) / q
        followed += (was - followed) * (1.0 - np.exp(-step / follower))
        slow += (followed - slow) * step * corner
        before, v = v, followed - slow
        if t + step < live:
            continue
        if waiting:
            reference, waiting = before + (v - before) * (live - t) / step, False
        if v - reference >= on or reference - v >= off:
            level = reference + on if v > reference else reference - off
            times.append(t + step * (level - before) / (v - before))
            polarities.append(1 if v > reference else 0)
            live, waiting = times[-1] + dead, True
    return times, polarities
