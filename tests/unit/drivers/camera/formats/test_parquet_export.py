"""Events in a Parquet file: what pandas and pyarrow read is what was recorded."""

import json
import sys

import numpy as np
import pytest

from drivers.camera.event_arrays import Triggers
from drivers.camera.formats import parquet_export
from drivers.camera.formats.event_conversion import convert
from drivers.errors import CameraSoftwareMissing, RecordingFileError
from tests.support.made_event_files import drawn_stream, same

parquet = pytest.importorskip("pyarrow.parquet")


def test_columns_and_metadata_hold_what_was_recorded(raw, tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.camera.formats.event_exports.GROUP_EVENTS", 700)
    summary = convert(raw, tmp_path / "pose.parquet", "parquet")
    events, triggers = drawn_stream()
    assert (summary.events, summary.triggers) == (len(events.t), len(triggers.t))
    table = parquet.read_table(tmp_path / "pose.parquet")
    assert {name: str(table.schema.field(name).type) for name in table.column_names} == {
        "t": "int64", "x": "uint16", "y": "uint16", "p": "uint8",
    }  # fmt: skip
    assert same([column.to_numpy() for column in table.columns], events)
    stated = parquet.read_metadata(tmp_path / "pose.parquet").metadata
    assert (stated[b"width"], stated[b"height"]) == (b"1280", b"720")
    assert json.loads(stated[b"header"])["serial_number"] == "00051234"
    edges = json.loads(stated[b"triggers"])
    assert same([np.array(edges[name]) for name in Triggers._fields], triggers)


def test_pandas_reads_the_file(raw, tmp_path):
    pandas = pytest.importorskip("pandas")
    convert(raw, tmp_path / "pose.parquet", "parquet")
    frame = pandas.read_parquet(tmp_path / "pose.parquet")
    assert same([frame[name].to_numpy() for name in "txyp"], drawn_stream()[0])


def test_more_edges_than_metadata_should_hold_are_refused(raw, tmp_path, monkeypatch):
    monkeypatch.setattr(parquet_export, "MOST_EDGES", 39)
    with pytest.raises(RecordingFileError, match="39 trigger edges; here are 40"):
        convert(raw, tmp_path / "pose.parquet", "parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["pose.raw"]


def test_without_pyarrow_the_remedy_is_named(raw, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CameraSoftwareMissing) as caught:
        convert(raw, tmp_path / "pose.parquet", "parquet")
    assert caught.value.remedy == "Install it: pip install 'starbench[table]'"
