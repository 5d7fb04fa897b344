"""A pixel of an event sensor, solved in steps: slow, but independent of the simulator's closed forms and tables."""

import numpy as np
from numba import njit


@njit
def _brightness(t, period, phase_us, shape, low, high, rising):
    """Return the light at a time; ``rising``: whether a square light is in its high part."""
    if shape == 0:
        return high if rising else low
    return 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2.0 * np.pi * (t + phase_us) / period)


@njit
def _runge_kutta(u, t, h, q, ambient, light, wave):
    """Take a fourth-order Runge-Kutta step of du/dt = (1 - I u) / q; return u at its end, and the slopes at start and end."""
    period, phase_us, shape, low, high, rising = wave
    first = ambient + light * _brightness(t, period, phase_us, shape, low, high, rising)
    middle = ambient + light * _brightness(t + 0.5 * h, period, phase_us, shape, low, high, rising)
    last = ambient + light * _brightness(t + h, period, phase_us, shape, low, high, rising)
    a = (1.0 - first * u) / q
    b = (1.0 - middle * (u + 0.5 * h * a)) / q
    c = (1.0 - middle * (u + 0.5 * h * b)) / q
    d = (1.0 - last * (u + h * c)) / q
    end = u + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return end, a, (1.0 - last * end) / q


@njit
def _within(s, h, before, slope, after, end_slope):
    """Return the Hermite cubic at a fraction s of a step."""
    r = 1.0 - s
    return r * r * ((1.0 + 2.0 * s) * before + s * h * slope) + s * s * (
        (1.0 + 2.0 * r) * after - r * h * end_slope
    )


@njit
def solve_closely(
    light, period, phase_us, shape, low, high, duty, ambient, q, on, off, dead, begin, end,
    reference_error=0.0, late_us=0.0,
):  # fmt: skip
    """Return the events of one pixel from ``begin`` (a reset, in the periodic steady state) to ``end``, us.

    Runge-Kutta steps of du/dt = (1 - I u) / q, each a fiftieth of the shortest time constant, end at the light's edges.
    Crossings are found by bisection on the Hermite cubic through a step. ``reference_error`` is added to the first
    reference (in ln u), ``late_us`` to the time of the first read.
    """
    longest = min(0.02 * q / (ambient + light * high), period / 3000.0)
    times, polarities = [0.0 for _ in range(0)], [0 for _ in range(0)]
    part = np.floor((begin + phase_us) / period) * period - phase_us  # start of the period
    rising = begin - part < duty * period
    edge = part + duty * period if rising else part + period
    # one period from u = 0 and from u = 1 gives the steady state, as u after a period is linear in u before
    low_u, high_u, u = 0.0, 1.0, 0.0
    for lap in range(2):
        t, until = begin, begin + period if lap == 0 else end
        next_edge, is_high = edge, rising
        reference, live, waiting = 0.0, begin, True
        while t < until:
            h = min(longest, until - t, next_edge - t)
            if lap == 1 and waiting:
                h = min(h, live - t) if live > t else h
            wave = (period, phase_us, shape, low, high, is_high)
            if lap == 0:
                low_u = _runge_kutta(low_u, t, h, q, ambient, light, wave)[0]
                high_u = _runge_kutta(high_u, t, h, q, ambient, light, wave)[0]
                t = next_edge if h == next_edge - t else t + h
            else:
                if waiting and t >= live:
                    reference, waiting = -np.log(u) + (reference_error if not times else 0.0), False
                after, slope, end_slope = _runge_kutta(u, t, h, q, ambient, light, wave)
                v = -np.log(after)
                if not waiting and (v - reference >= on or reference - v >= off):
                    target = np.exp(-(reference + on if v > reference else reference - off))
                    first, last = 0.0, 1.0
                    for _ in range(60):
                        s = 0.5 * (first + last)
                        if (_within(s, h, u, slope, after, end_slope) <= target) == (v > reference):
                            last = s
                        else:
                            first = s
                    times.append(t + last * h)
                    polarities.append(1 if v > reference else 0)
                    u, t = target, t + last * h
                    live, waiting = t + dead + (late_us if len(times) == 1 else 0.0), True
                    if dead == 0.0:
                        reference, waiting = -np.log(target), False
                    continue
                u = after
                t = next_edge if h == next_edge - t else live if waiting and h == live - t else t + h
            if t >= next_edge:
                next_edge += (1.0 - duty) * period if is_high else duty * period
                is_high = not is_high
        if lap == 0:
            u = low_u / (1.0 - (high_u - low_u))
    return times, polarities


def solve(light, share, phase, setting, thresholds, end, more=0.0, start_error=(0.0, 0.0)):
    """Return times and polarities of a pixel's events in 0 <= t < end, us; it starts two periods (at most 0.1 s) before.

    ``light`` is a LightState, ``share`` the share of it that reaches the pixel. ``more`` is added to the thresholds.
    ``start_error`` is an error of the first reference (in ln u), and one of the first read's time, us.
    """
    period, shape = light.period_us, 0 if light.waveform == "square" else 1
    times, polarities = solve_closely(
        float(share), period, phase * period, shape, light.low, light.high, light.high_share, setting.ambient,
        setting.q_us, thresholds[0] + more, thresholds[1] + more, setting.dead_us, -min(2.0 * period, 1e5), end,
        *start_error,
    )  # fmt: skip
    times, polarities = np.array(times), np.array(polarities, int)
    return times[times >= 0.0], polarities[times >= 0.0]


@njit
def solve_with_filters(
    light, period, phase_us, low, high, duty, ambient, q, follower, corner, on, off, dead, end
):
    """In steps, under a square light, with the follower's low-pass and the high-pass behind the photoreceptor.

    The steps are 0.1 us long; from 12 periods before 0, of which the last two have events, to ``end``.
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
