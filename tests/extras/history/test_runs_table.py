"""The table of runs: its schema, its files as strangers read them, and rows of unusual runs."""

import csv
import json
import math
import sys
from datetime import timedelta

import pytest
from click.testing import CliRunner
from many_runs import BEGIN, SIGMAS, VALUES, write_run

from bench.base.errors import UsageError
from bench.commands.cli import cli
from bench.evidence.states import ShownState
from bench.extras.history.columns import COLUMNS, SCHEMA, table_row
from bench.extras.history.table import ROWS_AT_ONCE, write_table
from bench.record.run_facts import RunPlace
from bench.record.run_index import RunIndex


def rows_of(home, folders):
    index = RunIndex(home)
    runs, faults = index.runs(folders)
    assert faults == []
    place = RunPlace("a", "b", "entered")
    return [table_row(run, details, place, ShownState()) for run, details in index.details(runs)]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    runs = [
        write_run(folder / f"run-{n}", begun=BEGIN + timedelta(hours=n), values={**VALUES, "fx": 3345.0 + n})
        for n in range(4)
    ]
    runs.append(write_run(folder / "none", begun=BEGIN + timedelta(hours=9), values=None, ended="failed"))
    return rows_of(folder / "home", runs)


@pytest.fixture(scope="module", params=[".parquet", ".csv"])
def table(request, tmp_path_factory, rows):
    if request.param == ".parquet":
        pytest.importorskip("pyarrow")
    path = tmp_path_factory.mktemp("table") / f"runs{request.param}"
    assert write_table(path, rows, ["a fault"]) == 5
    return path


def test_the_schema_that_is_printed_has_each_column_with_its_meaning_and_takes_a_row(rows):
    done = CliRunner().invoke(cli, ["schema", "runs-table"], standalone_mode=False)
    schema = json.loads(done.output)
    assert schema["title"] == SCHEMA
    stated = schema["properties"].items()
    shown = {name: (of["description"], of.get("unit", "")) for name, of in stated}
    assert shown == {column.name: (column.meaning, column.unit) for column in COLUMNS}
    jsonschema = pytest.importorskip("jsonschema")
    for row in rows:
        jsonschema.validate(json.loads(json.dumps(row, default=str)), schema)


def test_a_row_has_parameters_uncertainties_conditions_and_devices(rows):
    row = rows[1]
    assert (row["fx_px"], row["fx_sigma_px"], row["coverage_factor"]) == (3346.0, 1.0, 2.2)
    assert row["fx_expanded_px"] == pytest.approx(2.2)
    assert (row["camera_type"], row["camera_serial"]) == ("Prophesee EVK4", "00050001")
    assert row["stage_serials"] == ["1", "2"]
    assert (row["temperature_c"], row["flicker_hz"], row["stars"]) == (41.5, 60.0006, 600)
    assert (row["target_serial"], row["collimator_serial"], row["kind"]) == ("T-1", "C-1", "measured")
    assert row["warnings"] == ["Views differ more than star noise explains."]
    assert rows[4]["fx_px"] is None
    assert rows[4]["outcome"] == "failed"


def test_pandas_reads_it(table, rows):
    pandas = pytest.importorskip("pandas")
    if table.suffix == ".csv":
        frame = pandas.read_csv(table, dtype={"camera_serial": str}, parse_dates=["begun_utc"])
    else:
        frame = pandas.read_parquet(table)
        assert frame["warnings"].tolist()[0].tolist() == rows[0]["warnings"]
    assert list(frame.columns) == [column.name for column in COLUMNS]
    assert frame["fx_px"].tolist()[:4] == [3345.0, 3346.0, 3347.0, 3348.0]
    assert math.isnan(frame["fx_px"].tolist()[4])
    assert frame["simulated"].tolist() == [False] * 5
    assert frame["camera_serial"][0] == "00050001"
    assert frame["begun_utc"][0].to_pydatetime() == rows[0]["begun_utc"]


def test_rows_are_written_in_blocks_no_table_is_overwritten_and_a_failure_leaves_nothing(tmp_path, rows):
    pytest.importorskip("pyarrow")
    path = tmp_path / "runs.parquet"
    assert write_table(path, rows[:1] * (2 * ROWS_AT_ONCE + 3)) == 2 * ROWS_AT_ONCE + 3
    with pytest.raises(UsageError, match="exists"):
        write_table(path, rows)

    def failing():
        yield rows[0]
        raise OSError(28, "No space left on device")

    with pytest.raises(Exception, match="full"):
        write_table(tmp_path / "other.parquet", failing())
    assert [file.name for file in tmp_path.iterdir()] == ["runs.parquet"]


def test_what_is_no_number_is_empty_and_named(tmp_path):
    values = {**VALUES, "fx": None, "own": 1.5}
    folder = write_run(tmp_path / "run", values=values, sigmas={**SIGMAS, "own": 0.5}, temperature_c=None)
    (row,) = rows_of(tmp_path / "home", [folder])
    assert row["fx_px"] is None
    assert row["temperature_c"] is None
    assert row["warnings"][-1].startswith("fx ")
    assert json.loads(row["other_parameters"]) == {"own": {"value": 1.5, "sigma": 0.5}}


def test_results_that_were_changed_give_nothing_but_a_warning(tmp_path):
    folder, home = write_run(tmp_path / "run"), tmp_path / "home"
    assert rows_of(home, [folder])[0]["target_serial"] == "T-1"
    results = json.loads((folder / "results.json").read_text())
    results["run"]["target"]["serial"] = "T-2"
    (folder / "results.json").write_text(json.dumps(results))
    (row,) = rows_of(home, [folder])
    assert row["target_serial"] is None
    (warning,) = row["warnings"]
    assert warning.startswith("results.json was changed")
    assert row["fx_px"] == 3345.0  # the journal has it


def test_a_file_that_cannot_be_written_is_refused_with_what_to_do(tmp_path, monkeypatch):
    for name, what in (("runs.xlsx", "ending .xlsx"), ("runs", "no ending")):
        with pytest.raises(UsageError, match=what):
            write_table(tmp_path / name, [])
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"pip install 'starbench\[table\]'"):
        write_table(tmp_path / "runs.parquet", [])
    assert write_table(tmp_path / "runs.csv", []) == 0


@pytest.mark.parametrize("begin", ["=", "+", "-", "@", "\t", "\r", "\n", "\N{FULLWIDTH EQUALS SIGN}"])
def test_a_spreadsheet_takes_no_text_of_a_csv_table_for_a_formula(tmp_path, rows, begin):
    operator = f"{begin}cmd|'/c calc'!A1"
    row = {**rows[0], "operator": operator, "fx_px": -3345.5, "laboratory": "cam-7 = left"}
    write_table(tmp_path / "runs.csv", [row])
    with (tmp_path / "runs.csv").open(encoding="utf-8", newline="") as stream:
        (cells,) = csv.DictReader(stream)
    assert (cells["operator"], cells["laboratory"]) == (f"'{operator}", "cam-7 = left")
    assert float(cells["fx_px"]) == -3345.5
