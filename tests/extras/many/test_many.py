"""Conversions and checks by workers: as without them, continued after an interruption, nothing overwritten."""

import json
import shutil
from datetime import UTC, datetime

import numpy as np
import pytest
from click.testing import CliRunner

from bench.base.errors import UsageError
from bench.base.program import forms
from bench.commands.cli import cli
from bench.evidence.findings import Findings
from bench.evidence.key_trust import Trust
from bench.extras.tools.conversions import convert_many, plan_targets
from bench.work import verifications
from bench.work.kept_rows import KeptRows
from bench.work.verifications import Check, check_one
from bench.work.workers import Serial
from drivers.camera import CameraIdentity
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.formats.event_conversion import Evt3Encoder
from drivers.camera.raw_header import render_header

CAMERA = CameraIdentity("Prophesee", "EVK4", "IMX636", "1", "1", 1280, 720)


def run(*words):
    return CliRunner().invoke(cli, [str(word) for word in words], standalone_mode=False)


# ------------------------------------------------------------------ rows on the disk


def test_rows_are_kept_and_half_a_line_is_not_one(tmp_path):
    with KeptRows(tmp_path / "out", "rows.jsonl") as kept:
        kept.add("a", [0.1, 2])
        with pytest.raises(Exception, match="Another process"):
            KeptRows(tmp_path / "out", "rows.jsonl")
    with (tmp_path / "out" / "rows.jsonl").open("a") as stream:  # as after a power cut
        stream.write('{"key": "b", "va')
    for known in (None, 1):
        with KeptRows(tmp_path / "out", "rows.jsonl") as kept:
            assert (kept.get("a"), kept.get("b"), kept.get("c")) == ([0.1, 2], None, known)
            kept.add("c", 1)
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="something else"):
        KeptRows(tmp_path / "else", "rows.jsonl")


# ------------------------------------------------------------------ conversions


@pytest.fixture
def recordings(tmp_path):
    """Two small recordings."""
    folder = tmp_path / "in"
    folder.mkdir()
    for number in (1, 2):
        t = np.arange(4000, dtype=np.int64) * number
        x = np.full(4000, 3 + number, "u2")
        events = Events(t, x, x, np.ones(4000, "u1"))
        edges = Triggers(t[:2], np.array([0, 1], "u1"), np.zeros(2, "u1"))
        header = render_header(CAMERA, datetime(2026, 1, 1, tzinfo=UTC))
        (folder / f"p{number}.raw").write_bytes(header + Evt3Encoder().words(events, edges).tobytes())
    return sorted(folder.iterdir())


def converted(recordings, folder, ended=lambda _one: None):
    ends = []
    with KeptRows(folder, "converted.jsonl") as kept:
        pairs = plan_targets(recordings, folder, "numpy")
        convert_many(pairs, "numpy", Serial(), kept, lambda end: (ends.append(end), ended(end)))
    return ends


def test_an_interrupted_conversion_goes_on_and_replaces_nothing_of_others(recordings, tmp_path, monkeypatch):
    def interrupt(_one):
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        converted(recordings, out, interrupt)
    assert [path.name for path in sorted(out.iterdir())] == ["converted.jsonl", "p1.npz"]
    (out / ".part-p2.npz").write_text("half")
    assert [(end.before, end.failure) for end in converted(recordings, out)] == [(True, None), (False, None)]
    assert [end.before for end in converted(recordings, out)] == [True, True]
    assert not list(out.glob(".part*"))
    with np.load(out / "p2.npz") as arrays:
        assert len(arrays["t"]) == 4000
    monkeypatch.setattr("bench.extras.tools.conversions.forms", lambda: {"program": "newer"})
    monkeypatch.setattr("bench.extras.tools.conversions.require_program_of", lambda _program: None)
    assert [end.before for end in converted(recordings, out)] == [False, False], "by another program, again"
    before = (out / "p1.npz").read_bytes()
    recordings[0].write_bytes(recordings[1].read_bytes())
    (out / "p2.npz").write_bytes(b"changed")
    ends = converted(recordings, out)
    assert ["not the conversion" in end.failure.what for end in ends] == [True, True]
    assert (out / "p1.npz").read_bytes() == before


def test_the_command_converts_many_into_a_folder(recordings, tmp_path, monkeypatch):
    monkeypatch.setattr("bench.extras.tools.convert.open_workers", lambda *_, **__: Serial())
    words = ["convert", *recordings, tmp_path / "out", "--as", "numpy"]
    ended = run(*words)
    assert "2 of 2 files converted." in ended.stdout
    assert "4000 events, 2 triggers" in ended.stdout
    recordings[1].write_bytes(b"no events")
    shutil.rmtree(tmp_path / "out")
    ended = run(*words)
    assert ended.return_value == 1
    assert "1 of 2 files converted; 1 FAILED." in ended.stdout
    assert "FAILED" in ended.stderr
    assert "format" in str(run("convert", *recordings, tmp_path / "out2").exception)
    twice = [recordings[0], tmp_path / "p1.raw"]
    with pytest.raises(UsageError, match=r"would become p1\.npz"):
        plan_targets(twice, tmp_path, "numpy")


# ------------------------------------------------------------------ checks of sealed folders


@pytest.fixture
def derived(monkeypatch):
    """Folders that were derived again."""
    folders = []

    def derivation(folder):
        folders.append(folder)
        return Findings(remarks=["derived again"])

    monkeypatch.setattr(verifications, "derivations_of", lambda _folder, *, again: [derivation])
    return folders


def test_only_what_was_derived_again_is_kept(sealed, signers, derived):
    check = Check(Trust(tuple(signers)), None, None, True, forms()["program"])
    first = check_one(sealed, check, None)
    assert (first.verification.ok, first.before) == (True, False)
    row = json.loads(json.dumps(first.row))
    second = check_one(sealed, check, row)
    assert (second.verification, second.before) == (first.verification, True)
    assert len(derived) == 1
    check_one(sealed, Check(check.trust, None, None, False, check.program), row)
    assert len(derived) == 2, "another check is made"
    nobody = check_one(sealed, Check(Trust(), None, None, True, check.program), row)
    assert not nobody.verification.ok, "trust is never kept"
    (sealed / "results.json").write_text("{}")
    changed = check_one(sealed, check, row)
    assert {fault.where for fault in changed.verification.faults} == {"results.json"}


def test_the_command_checks_many_folders_and_names_each(sealed, home, tmp_path, derived, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(home))
    shutil.copytree(sealed, tmp_path / "other")
    (tmp_path / "other" / "results.json").write_text("{}")
    monkeypatch.setattr("bench.commands.verify.open_workers", lambda *_, **__: Serial())
    ended = run("verify", sealed, tmp_path / "other", "-o", tmp_path / "kept")
    assert ended.return_value == 1
    assert "other: NOT VERIFIED." in ended.stdout
    assert "2 folders:" in ended.stdout
