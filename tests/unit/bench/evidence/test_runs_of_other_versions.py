"""A run of another version of the program, or with a plug-in: what is compared, and what is said."""

import contextlib
import io

import pytest

from bench.commands.verify import show_verification
from tests.unit.bench.evidence.attack_steps import by_another_program, checked, result
from tests.unit.bench.evidence.resealed import kinds

pytestmark = pytest.mark.usefixtures("made_once")


def with_a_plugin(f):
    """Journal and results state a plug-in that this computer does not have."""
    f.edit_line("run_started", lambda d: d.update(plugins={"starbench-turntable": ["stage turntable"]}))
    f.edit_results(lambda r: r["run"].update(plugins={"starbench-turntable": ["stage turntable"]}))
    by_another_program(f, **{"starbench-turntable": "1.0"})


def test_a_run_on_a_plugin_that_is_not_here_is_not_compared_and_no_fault(forger, trusted):
    with_a_plugin(forger)
    station = (forger / "station.yaml").read_text().replace("driver: zaber_ascii", "driver: turntable")
    (forger / "station.yaml").write_text(station)
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.faults == ()
    (what,) = found.not_compared
    assert "the station needs starbench-turntable 1.0, which this computer does not have" in what


def test_a_plugin_that_the_station_does_not_use_is_found(forger, trusted):
    with_a_plugin(forger)
    forger.seal()
    found = checked(forger.folder, trusted)
    assert "journal.jsonl:1" in {fault.where for fault in found.faults}
    assert "the stage turntable was driven by a plug-in: starbench-turntable 1.0" in found.remarks


def test_another_program_that_writes_the_same_bytes_is_compared(forger, trusted, job):
    by_another_program(forger, program="0" * 16)
    forger.render(job)
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.complete
    assert any("program 0000000000000000 (here " in remark for remark in found.remarks)


def test_a_report_of_another_form_is_not_compared_and_the_folder_not_plainly_valid(forger, trusted):
    by_another_program(forger, report_form="0" * 16)
    forger.replace("report.html", "Calibration report", "Report of a calibration")
    forger.tell_of_files()
    forger.seal()
    found = checked(forger.folder, trusted)
    assert found.ok
    assert not found.complete
    assert [what for what in found.not_compared if what.startswith("report.html with results.json")]
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        assert show_verification(found) == 4
    assert "NOT COMPARED. Only the seal protects these parts" in shown.getvalue()


def test_another_program_does_not_excuse_what_both_state(forger, trusted):
    by_another_program(forger, program="0" * 16, starbench="9.9")
    result("devices", "camera", "serial", to="00050999")(forger)
    forger.seal()
    assert ("results", "results.json") in kinds(checked(forger.folder, trusted))
