"""What the comparison of two checkouts sees, and what it passes over, on small folders made up here."""

import json
from datetime import UTC, datetime

import h5py
import numpy as np
import pytest
from comparison.differences import Expected, compare, read_expected, relative, sort_out
from comparison.reading import read_folder

SEALED = "5e" * 32


def write_run(
    folder, *, fx=1671.25, seconds=0, key="accepted", message="The port is not there.", polls=1, value=0.5
):
    """A run, and what a command said of it, at a time and in a folder of their own."""
    (folder / "run" / "exports").mkdir(parents=True)
    utc = datetime(2026, 3, 1, 20, 0, seconds, tzinfo=UTC).isoformat()
    results = {
        "calibration": {"camera": {"fx": fx}, "covariance": [[1.5, 0.25], [0.25, 2.0]]},
        "begun_utc": utc,
    }
    (folder / "run" / "results.json").write_text(json.dumps(results))
    lines = [
        {"seq": 0, "utc": utc, "mono_s": 1.5 + seconds, "event": "run_started", "hash": SEALED},
        {"seq": 1, "utc": utc, "mono_s": 2.5 + seconds, "event": "attempt_checked", key: True, "pose": 1},
    ]
    (folder / "run" / "journal.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    port = f"{folder}/tmp/starbench-abcd{seconds:04d}/gimbal"
    sent = [("/1 1 04 move abs 5:AB\n", "@01 1 04 OK BUSY -- 0:C1\r\n")]
    sent += [
        (f"/1 1 {5 + n:02d} get pos:7C\n", f"@01 1 {5 + n:02d} OK BUSY -- {n}:48\r\n") for n in range(polls)
    ]
    sent += [(f"/1 1 {5 + polls:02d} get pos:7C\n", f"@01 1 {5 + polls:02d} OK IDLE -- 5:48\r\n")]
    wire = [
        {"t": seconds + 0.1, "port": port, "dir": direction, "bytes": text}
        for pair in sent for direction, text in zip("><", pair, strict=True)
    ]  # fmt: skip
    (folder / "run" / "wire.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in wire))
    with h5py.File(folder / "run" / "views.h5", "w") as file:
        file.attrs["format"] = "starbench/views/1"
        file["pose-001/points_px"] = np.array([[1.0, 2.0], [3.0, value]])
    (folder / "run" / "exports" / "opencv.yaml").write_text(f"fx: {fx}\n")
    (folder / "run" / "capture.raw").write_bytes(
        f"% date {utc[:10]} {utc[11:19]}\n% end\n".encode() + b"\0\1\2"
    )
    (folder / "said.stderr").write_text(f"{folder}/station.yaml: {message}\n")
    return folder


@pytest.fixture
def differences(tmp_path):
    """Compare the run of a function's first words with that of its second ones."""

    def differences_with(**changes):
        read = []
        for name, more in (("old", {}), ("new", {"seconds": 7, **changes})):
            folder = write_run(tmp_path / name, **more)
            read.append(read_folder(folder, [(str(folder), "folder")]))
        return compare("made_up", *read)

    return differences_with


def test_times_hashes_folders_and_more_polls_are_no_differences(differences):
    assert differences(polls=4) == []


@pytest.mark.parametrize(
    ("changed", "places"),
    [
        ({"fx": 1671.2500000000002}, ["run/exports/opencv.yaml", "run/results.json/calibration/camera/fx"]),
        ({"message": "The port is missing."}, ["said.stderr"]),
        ({"value": 0.25}, ["run/views.h5/pose-001/points_px"]),
        (
            {"key": "passed"},
            ["run/journal.jsonl/attempt_checked-1/accepted", "run/journal.jsonl/attempt_checked-1/passed"],
        ),
    ],
)
def test_a_number_a_message_an_array_and_a_key_are_found_at_their_places(differences, changed, places):
    assert [difference.place for difference in differences(**changed)] == places


def test_a_file_an_event_and_a_byte_on_the_wire_that_are_missing_are_found(tmp_path):
    old, new = (write_run(tmp_path / name) for name in ("old", "new"))
    (new / "run" / "exports" / "opencv.yaml").unlink()
    journal, wire = new / "run" / "journal.jsonl", new / "run" / "wire.jsonl"
    journal.write_text(journal.read_text().splitlines()[0] + "\n")
    wire.write_text(wire.read_text().replace("move abs 5", "move abs 6"))
    read = [read_folder(folder, [(str(folder), "folder")]) for folder in (old, new)]
    words_at = {difference.place: difference.words for difference in compare("made_up", *read)}
    assert words_at["run/exports/opencv.yaml"].startswith("only old")
    assert "-attempt_checked" in words_at["run/journal.jsonl (events)"]
    assert "move abs 6" in words_at["run/wire.jsonl/gimbal"]


def test_differences_on_purpose_are_told_apart_by_place_words_and_size(differences):
    differing = differences(fx=1671.25 * (1 + 1e-9), message="The port is missing.")
    entries = [
        Expected("made_up", "*/camera/fx", "one loop", relative=1e-8),
        Expected("*", "said.stderr", "plainer", says="is gone"),
        Expected("other", "*", "never played"),
    ]
    reasons = {difference.place: reason for difference, reason in sort_out(differing, entries)}
    assert reasons["run/results.json/calibration/camera/fx"] == "one loop"
    assert reasons["said.stderr"] is None
    assert [entry.matched for entry in entries] == [1, 0, 0]


def test_relative_differences_are_those_of_the_largest_number():
    assert relative(np.array([4.0, 0.0]), np.array([4.0, 1.0])) == 0.25
    assert relative(np.array([np.nan, 1.0]), np.array([np.nan, 1.0])) == 0
    assert relative(np.array([np.nan]), np.array([1.0])) is None
    assert relative("4", 4) is None
    assert relative(0, 0) == 0


def test_an_entry_without_a_reason_is_refused(tmp_path):
    (tmp_path / "listed.yaml").write_text('- {scenario: "*", place: "*"}\n')
    with pytest.raises(TypeError, match="reason"):
        read_expected(tmp_path / "listed.yaml")
