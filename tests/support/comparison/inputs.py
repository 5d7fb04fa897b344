"""The files that both sides get: those shipped with the old checkout, some of them made smaller and quicker, or bad."""

from pathlib import Path

#: A small sensor and devices that do not wait where the real ones would: a run takes seconds.
_QUICK = "  paced: false\n"
_SMALL = f"{_QUICK}  camera: {{width: 640, height: 360, fx: 1672, fy: 1672, cx: 320, cy: 180}}\n"


def replaced(text: str, *changes: tuple[str, str]) -> str:
    """A text with changes, each of which must fit."""
    for old, new in changes:
        if old not in text:
            raise ValueError(
                f"the shipped file has no {old!r} any more: change tests/support/comparison/inputs.py"
            )
        text = text.replace(old, new)
    return text


def station(old: Path, name: str = "simulated", *changes: tuple[str, str]) -> str:
    """A shipped station of a collimator bench with the small sensor and a quick stage."""
    return replaced(
        (old / f"bench/stations/{name}.yaml").read_text(encoding="utf-8"),
        ("simulation:\n", f"simulation:\n{_SMALL}"),
        ("focal_px: 3300\n", "focal_px: 1672\n  image_size: [640, 360]\n"),
        ("speed_deg_s: 40", "speed_deg_s: 90"),
        ("acceleration_deg_s2: 200", "acceleration_deg_s2: 2000"),
        *changes,
    )


def sequence(old: Path, name: str, *changes: tuple[str, str]) -> str:
    return replaced((old / f"sequences/{name}.yaml").read_text(encoding="utf-8"), *changes)


QUEUE = """\
format: starbench/queue/1
name: Three jobs
jobs:
  - {name: first, sequence: three.yaml, station: station.yaml, seed: 1}
  - {name: broken, sequence: three.yaml, station: broken.yaml, seed: 1, attempts: 1}
  - {name: last, sequence: three.yaml, station: station.yaml, seed: 2}
"""
NIGHT = """\
format: starbench/queue/1
name: A rehearsed night
zone: Europe/Berlin
start_at: "20:00"
stop_by: "23:00"
jobs:
  - {name: nine, sequence: nine_pose, station: simulated, times: 4, every_min: 30, seed: 100}
  - {name: turntable, sequence: turntable, station: simulated, times: 2, seed: 200}
  - {name: until, sequence: until_good, station: simulated, seed: 300}
  - {name: warm, sequence: three_pose, station: warm.yaml, times: 3, seed: 400, priority: 2}
  - {name: late, sequence: nine_pose, station: simulated, start_at: "22:50", times: 5}
"""
#: Recordings that fail, a room that warms up: what a rehearsal can let happen.
WARM = (
    "simulation:\n",
    "simulation:\n  rehearsal: {room_c_per_h: 1, self_heating_c: 6, focal_ppm_per_c: 20, covered_share: 0.15}\n",
)

#: Name, change of the sequence, change of the station: each is given to `run`, which must refuse it.
BAD_FILES: dict[str, tuple[tuple[str, str] | None, tuple[str, str] | None]] = {
    "word-for-number": (("frequency_hz: 60", "frequency_hz: sixty"), None),
    "unknown-key": (("window_ms: 33", "windowms: 33"), None),
    "key-twice": (("name: Three poses", "name: Three poses\nname: Four"), None),
    "pose-outside": (("pan_deg: -6", "pan_deg: -60"), None),
    "unknown-poses": (("poses: three", "poses: four"), None),
    "unknown-step": (("steps: [move, settle, record]", "steps: [move, wink, record]"), None),
    "no-move": (("steps: [move, settle, record]", "steps: [settle, record]"), None),
    "not-yaml": (("defaults:", "defaults: ["), None),
    "other-format": (("starbench/sequence/1", "starbench/sequence/9"), None),
    "infinite": (("window_ms: 33", "window_ms: .inf"), None),
    "negative": (("window_ms: 33", "window_ms: -1"), None),
    "yaml-alias": (("  - light\n", "  - &a light\n  - *a\n"), None),
    "yaml-tag": (("name: Three poses", "name: !!python/name:os.system x"), None),
    "unknown-lens": (("distortion: [k1, k2]", "distortion: [k1, q2]"), None),
    "both-files": (("window_ms: 33", "window_ms: x"), ("device: 2", "device: two")),
    "unknown-driver": (None, ("driver: zaber_ascii", "driver: zaber_binary")),
    "list-for-serial": (None, ("serial: 100101", "serial: [1]")),
    "other-serial": (None, ("serial: 100102", "serial: 999999")),
    "other-camera": (None, ("serial: 00050423", 'serial: "00000001"')),
    "missing-port": (None, ("port: sim:light", "port: /dev/serial/by-id/none")),
    "no-simulation": (None, ("simulation:\n  collimator: {profile: like-bench, glass_seed: 1104}\n", "simulated:\n")),
    "limits-turned": (None, ("limits_deg: [-15, 15]", "limits_deg: [15, -15]")),
    "speed-zero": (None, ("speed_deg_s: 40", "speed_deg_s: 0")),
    "unknown-section": (None, ("expected:", "expectd:")),
    "no-certificate-number": (None, ("    r_mm: 255.0\n", "    r_mm: two\n")),
    "unknown-fault": (None, ("simulation:\n", "simulation:\n  faults: [{device: pan, fault: yawn}]\n")),
}  # fmt: skip
#: Arguments that every version must refuse in the same words, and small commands that answer with JSON or a page.
SHORT_COMMANDS: dict[str, str] = {
    "no-command": "", "unknown-command": "calibrat", "unknown-option": "run --fast", "no-sequence": "run",
    "no-station": "run three_pose", "missing-sequence": "run missing -s simulated -o out",
    "missing-station": "run three_pose -s missing -o out", "bad-seed": "run three_pose -s simulated --seed -1",
    "word-as-seed": "run three_pose -s simulated --seed seven", "bad-set": "run three_pose -s simulated --set x",
    "set-unknown": "plan three_pose -s simulated --set sequence.defaults.recrd.window_ms=3",
    "status-of-nothing": "status nowhere", "resume-of-nothing": "resume nowhere", "verify-nothing": "verify nowhere",
    "calibrate-nothing": "calibrate nowhere", "calibrate-text": "calibrate three.yaml",
    "hold-nothing": "tell nowhere hold", "answer-maybe": "tell nowhere maybe", "skip-no-pose": "tell nowhere skip",
    "queue-with-station": "plan queue.yaml -s simulated", "batch-without-folder": "batch queue.yaml",
    "batch-of-a-sequence": "batch three.yaml -o out", "convert-unknown": "convert three.yaml out.xyz",
    "certificate-of-nothing": "certificate issue nowhere -c lab.yaml -o out", "passport-of-text": "passport show three.yaml",
    "rig-of-nothing": "rig nowhere nothing", "schema-unknown": "schema run",
    "recalibrate-nothing": "calibrate --each nowhere -o out",
    "version": "--version", "help": "--help", "help-run": "run --help", "help-calibrate": "calibrate --help",
    "help-align": "align --help", "help-batch": "batch --help", "help-certificate": "certificate --help",
    "help-passport": "passport --help", "help-runs": "runs --help", "help-verify": "verify --help",
    "help-keys": "keys --help", "help-target": "target --help", "help-panel": "panel --help",
    "plan-three": "plan three_pose -s simulated", "plan-three-json": "plan three_pose -s simulated --json",
    "plan-nine-json": "plan nine_pose -s simulated --suggest 2 --json",
    "plan-turntable-json": "plan turntable -s simulated --json",
    "plan-parallax": "plan parallax_test -s simulated --json", "plan-frames": "plan three_pose -s simulated_frames --json",
    "plan-until": "plan until_good -s simulated --json", "plan-example": "plan turntable -s example_turntable",
    "plan-thorlabs": "plan three_pose -s example_thorlabs", "plan-network": "plan three_pose -s example_network",
    "plan-evk4": "plan three_pose -s example_evk4",
    "plan-night": "plan queue.yaml --begin 2026-03-01T21:00 --json", "runs-json": "runs --json", "runs": "runs",
    "devices-json": "devices --json", "ledger-json": "ledger --json", "messages-json": "messages --json",
    "keys": "keys show", "schema-sequence": "schema sequence", "schema-station": "schema station",
    "schema-queue": "schema queue", "schema-job": "schema job", "schema-lab": "schema lab",
    "target-show": "target -s simulated --json",
    "target-draw": "target -s simulated -o target.svg",
    "certificate-new": "certificate new new_lab.yaml", "certificate-list": "certificate show --json",
}  # fmt: skip
