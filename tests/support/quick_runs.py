"""A simulated bench with a small sensor and a fast stage, and sequences for it: runs that take seconds."""

from station_texts import PLAIN

SIMULATION = (
    "simulation: {%sports: pty, paced: false, noise: typical, "
    "camera: {width: 640, height: 360, fx: 1672, fy: 1672, cx: 320, cy: 180}}"
)
SEQUENCE = """\
format: starbench/sequence/1
name: Quick poses
defaults:
  light: {frequency_hz: 240}
  settle: {duration_s: 0.3}
  record: {window_ms: %(window_ms)s, attempts: %(attempts)d, backoff_s: 0.1}
steps:
  - light
  - repeat:
      poses: %(poses)s
      steps: [move, settle, record]
%(end)s"""
END = "  - solve: {model: spherical, distortion: [k1]}\n  - report\n"
UNTIL = """\
format: starbench/sequence/1
name: Quick until
defaults:
  light: {frequency_hz: 240}
  settle: {duration_s: 0.1}
  record: {window_ms: 8.4, attempts: 1}
  solve: {model: %s, distortion: [k1, k2]}
steps:
  - light
  - until: %s
  - light: off
  - solve
  - report
"""
THREE = "[{pan_deg: -6, tilt_deg: 2}, {pan_deg: 6, tilt_deg: 2}, {pan_deg: 0, tilt_deg: -3}]"
THREE_NAMED = "[{name: left, pan_deg: -6, tilt_deg: 2}, {name: right, pan_deg: 6, tilt_deg: 2}, {name: below, tilt_deg: -3}]"
TWELVE = "{pan_deg: {first: -6, last: 6, count: 4}, tilt_deg: {first: -3, last: 3, count: 3}}"


def write_station(path, more="", simulation=""):
    """A station file with the small sensor; ``more`` is put at its end, ``simulation`` into its simulation."""
    text = PLAIN
    for old, new in (
        ("simulation: {}", SIMULATION % simulation),
        ("speed_deg_s: 40", "speed_deg_s: 90"),
        ("acceleration_deg_s2: 200", "acceleration_deg_s2: 2000"),
        ("focal_px: 3300, ", "focal_px: 1672, image_size: [640, 360], "),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text + more)
    return path


def write_sequence(path, poses=TWELVE, *, attempts=2, window_ms=8.4, end=END):
    path.write_text(SEQUENCE % {"poses": poses, "attempts": attempts, "window_ms": window_ms, "end": end})
    return path


def write_until(path, until, model="spherical"):
    """A sequence that chooses its poses; ``until`` is the mapping of the step as text."""
    path.write_text(UNTIL % (model, until))
    return path
