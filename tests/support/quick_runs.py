"""A simulated bench with a small sensor and a fast stage, and sequences for it: runs that take seconds."""

import yaml
from station_texts import PLAIN

SIMULATION = (
    "simulation: {%sports: pty, paced: false, noise: typical, "
    "camera: {width: 640, height: 360, fx: 1672, fy: 1672, cx: 320, cy: 180}}"
)
CONFIG = yaml.safe_load(SIMULATION % "")["simulation"]
SEQUENCE = """\
format: starbench/sequence/1
name: Quick poses
defaults:
  light: {frequency_hz: 240}
  settle: {duration_s: 0.3}
  record: {window_ms: %(window_ms)s, attempts: %(attempts)d, backoff_s: 0.1}
steps:
%(first)s  - light
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
  solve: {model: spherical, distortion: [k1, k2]}
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


def write_station_of(path, world, more=""):
    """A station file of the ports of a simulated bench, which outlives the runs on it."""
    text = write_station(path, more).read_text().replace(SIMULATION % "", "")
    for name, port in world.endpoints.items():
        text = text.replace(f"sim:{name}", port)
    path.write_text(text)
    return path


def write_sequence(path, poses=TWELVE, *, attempts=2, window_ms=8.4, first="", end=END):
    """A sequence that records poses; ``first`` and ``end`` are the steps before and after them."""
    words = {"poses": poses, "attempts": attempts, "window_ms": window_ms, "first": first, "end": end}
    path.write_text(SEQUENCE % words)
    return path


def quick_words(folder, poses=TWELVE, *, station="", seed=7, **sequence):
    """The words of a run of this bench, whose files and results stand in ``folder``."""
    folder.mkdir(exist_ok=True)
    poses_file = write_sequence(folder / "sequence.yaml", poses, **sequence)
    bench = write_station(folder / "station.yaml", station)
    return "run", poses_file, "-s", bench, "--seed", seed, "-o", folder / "run"


def write_queue(path, *jobs, head="name: Night\n"):
    """A queue of jobs, each of them the mapping of one as text."""
    lines = "".join(f"  - {{{job}}}\n" for job in jobs)
    path.write_text(f"format: starbench/queue/1\n{head}jobs:\n{lines}")
    return path


def write_until(path, until):
    """A sequence that chooses its poses; ``until`` is the mapping of the step as text."""
    path.write_text(UNTIL % until)
    return path
