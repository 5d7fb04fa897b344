"""The wire log: every byte, readable, bounded. (A file in a temporary folder is its subject.)"""

import json

from drivers.wire_log import WireLogFile


def entries(path) -> list[dict]:
    return [json.loads(text) for text in path.read_text().splitlines()]


def test_any_byte_can_be_read_back(tmp_path) -> None:
    log = WireLogFile(tmp_path / "wire.jsonl")
    data = bytes(range(256))
    log.record(1.25, "port", ">", data)
    log.close()
    (entry,) = entries(log.path)
    assert entry["bytes"].encode("latin-1") == data
    assert (entry["t"], entry["port"], entry["dir"]) == (1.25, "port", ">")


def test_an_existing_log_is_continued(tmp_path) -> None:
    for number in range(2):
        log = WireLogFile(tmp_path / "wire.jsonl")
        log.record(float(number), "port", "<", b"x")
        log.close()
    assert [entry["t"] for entry in entries(log.path)] == [0.0, 1.0]


def test_the_log_is_bounded_and_keeps_the_latest(tmp_path) -> None:
    log = WireLogFile(tmp_path / "wire.jsonl", max_bytes=500, kept=2)
    for number in range(100):
        log.record(float(number), "port", "<", b"x" * 20)
    log.close()
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == ["wire.jsonl", "wire.jsonl.1", "wire.jsonl.2"]
    assert all(file.stat().st_size <= 500 for file in files)
    kept = [entry["t"] for file in reversed(files) for entry in entries(file)]
    assert kept == [float(number) for number in range(100 - len(kept), 100)]


def test_a_log_that_cannot_be_written_says_so_and_disturbs_nothing(tmp_path) -> None:
    log = WireLogFile(tmp_path / "missing" / "wire.jsonl")
    log.record(0.0, "port", ">", b"stop\n")
    log.record(0.0, "port", ">", b"stop\n")
    assert log.fault is not None
    assert "No such file or directory" in log.fault
