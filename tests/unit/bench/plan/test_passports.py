"""The passport of a run: which file the documents name, what is wrong with it, and what speaks against it."""

import hashlib
import json
from datetime import date

import numpy as np
import pytest
from station_texts import PLAIN

from bench.evidence.seal import seal_passport
from bench.plan.job import Job, calibration_options, documents_of
from bench.plan.passports import passport_bytes
from bench.plan.plan import load_documents, make_plan
from bench.plan.plan_text import render_plan
from bench.records.run_folder import PASSPORT_COPY, SEQUENCE_COPY, STATION_COPY
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport

TODAY = date(2026, 6, 1)
SEQUENCE = """\
format: starbench/sequence/1
name: S
steps:
  - light
  - move: {pan_deg: 1}
  - settle
  - record
%s  - light: off
  - solve%s
  - report
"""
MORE = "  - move: {pan_deg: 2}\n  - settle\n  - record\n"
CERTIFICATE = "certificate: {r_mm: 255, uncertainty_mm: 0.1, number: T-1, valid_until: 2027-01-01}"


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A folder with a station and a sequence; returns a function that plans them."""
    (tmp_path / "a").mkdir()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    kept = [line for line in PLAIN.splitlines() if not line.startswith("collimator:")]

    def plan(solve: str = "", collimator: str = "serial: C-1", settings=None, *, more=MORE, **options):
        (tmp_path / "a" / "s.yaml").write_text(SEQUENCE % (more, f": {solve}" if solve else ""))
        station = "\n".join(kept) + f"\ncollimator: {{{collimator}}}\n"
        (tmp_path / "a" / "b.yaml").write_text(station)
        files = (str(tmp_path / "a" / "s.yaml"), str(tmp_path / "a" / "b.yaml"))
        return make_plan(*load_documents(*files, settings), today=options.pop("today", TODAY), **options)

    return plan


def write(path, r=255.0, *, sealed_with=None, **conditions):
    data = passport_bytes(Passport.of_radius(r, 0.05, conditions))
    path.write_bytes(seal_passport(data, sealed_with) if sealed_with else data)
    return path


@pytest.fixture
def own_home(home, monkeypatch):
    """The bench with the key of the session."""
    monkeypatch.setenv("STARBENCH_HOME", str(home))


def solve_of(plan):
    return next(step for step in plan.script if hasattr(step, "loss"))


def texts(faults) -> list[str]:
    return [f"{fault.line}:{fault.column}: {fault.path}: {fault.message}" for fault in faults]


def test_one_direction_is_enough_if_the_passport_holds_the_centre(bench, tmp_path):
    assert "only one direction is recorded" in texts(bench(more="").faults)[0]
    write(tmp_path / "a" / "p.json", collimator="C-1")
    assert (
        "A certificate of its focal length is not enough."
        in texts(bench("{passport: p.json}", more="").faults)[0]
    )
    whole = Passport(
        ("x", "y", "r"), np.array([100.0, 140, 255]), np.eye(3), conditions={"collimator": "C-1"}
    )
    (tmp_path / "a" / "p.json").write_text(json.dumps(whole.to_dict()))
    assert bench("{passport: p.json}", more="").faults == ()
    assert bench("{passport: none}", "serial: C-1, passport: p.json", more="").faults != ()


def test_a_path_is_relative_to_the_file_that_names_it_or_to_the_working_directory(bench, tmp_path):
    write(tmp_path / "a" / "p.json", 255, collimator="C-1")
    write(tmp_path / "elsewhere" / "p.json", 256, collimator="C-1")
    for plan, r, source in (
        (bench("{passport: p.json}"), 255, "sequence"),
        (bench("", "serial: C-1, passport: p.json"), 255, "station"),
        (bench(settings={"sequence.defaults.solve.passport": "p.json"}), 256, "sequence"),
        (bench(settings={"station.collimator.passport": "p.json"}), 256, "station"),
    ):
        assert plan.faults == ()
        assert plan.passport.in_use.source == source
        assert plan.passport_for(solve_of(plan)).values_by_name == {"r": r}


def test_the_certificate_of_the_station_becomes_a_passport_of_the_run(bench):
    plan = bench("", f"serial: C-1, {CERTIFICATE}")
    assert plan.passport.in_use.to_dict() | {"sha256": ""} == {
        "source": "station certificate",
        "name": "certificate",
        "collimator": "C-1",
        "number": "T-1",
        "date": None,
        "valid_until": "2027-01-01",
        "temperature_c": None,
        "values": {"r": 255.0},
        "sigma": {"r": pytest.approx(0.05)},
        "sha256": "",
        "sealed_by": None,
    }
    assert plan.remarks == ()
    assert calibration_options(solve_of(plan), plan.passport_for(solve_of(plan))).model == "auto"


def test_the_sequence_wins_over_the_station_and_none_switches_it_off(bench, tmp_path):
    write(tmp_path / "a" / "p.json", 256, collimator="C-1")
    named = bench("{passport: p.json}", f"serial: C-1, {CERTIFICATE}")
    assert named.passport.in_use.passport.values_by_name == {"r": 256.0}
    assert bench("{passport: none}", f"serial: C-1, {CERTIFICATE}").passport.in_use is None
    assert bench("{model: planar}", f"serial: C-1, {CERTIFICATE}").passport.in_use is None
    assert "the planar model has no collimator" in str(bench("{model: planar, passport: p.json}").faults)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "There is no such passport file."),
        ("{", "not JSON, line 1, column 2: "),
        ("[]", "Not a passport: its schema is None."),
        ("\xff", "The file is not a passport"),
        ('{"schema": "starbench/results/1"}', "its schema is 'starbench/results/1'"),
        ("1" * 1_000_001, "The file is too large for a passport."),
    ],
)
def test_a_file_that_is_no_passport_is_a_fault_where_it_is_named(bench, tmp_path, content, said):
    if content is not None:
        (tmp_path / "a" / "p.json").write_text(content, encoding="latin-1")
    (fault,) = bench("{passport: p.json}").faults
    assert (fault.line, fault.column, fault.path) == (12, 23, "steps[8].solve.passport")
    assert said in fault.message


def test_a_folder_a_negative_radius_and_an_unknown_term_are_no_passports(bench, tmp_path):
    (tmp_path / "a" / "folder").mkdir()
    assert "This is a folder, not a passport file." in str(bench("{passport: folder}").faults)
    write(tmp_path / "a" / "p.json", -255.0)
    assert "radius r is not positive" in str(bench("{passport: p.json}").faults)
    found = Passport.of_radius(255, 0.1).to_dict()
    found |= {"names": ["r", "wobble"], "values": [255, 1], "covariance": [[1, 0], [0, 1]]}
    (tmp_path / "a" / "p.json").write_text(json.dumps(found | {"reference": [1, 2, 3]}))
    assert "unknown parameter 'wobble'" in str(bench("{passport: p.json}").faults)


def test_a_passport_of_another_collimator_is_a_fault_unless_it_is_accepted(bench, tmp_path):
    write(tmp_path / "a" / "p.json", collimator="C-2")
    (fault,) = bench("{passport: p.json}").faults
    assert "the passport belongs to the collimator C-2; the station's is C-1" in fault.message
    accepted = bench("{passport: p.json, other_collimator: accept}")
    assert accepted.faults == ()
    assert "belongs to the collimator C-2" in str(accepted.remarks)


@pytest.mark.usefixtures("own_home")
def test_what_speaks_against_a_passport_is_remarked(bench, tmp_path, key):
    write(tmp_path / "a" / "p.json", temperature_c=20, valid_until="2026-05-31")
    remarks = str(bench("{passport: p.json}", "serial: C-1, temperature_c: 26").remarks)
    assert "expired on 2026-05-31; the run is of 2026-06-01" in remarks
    assert "holds at 20 °C; the bench is at 26 °C, 6 °C apart" in remarks
    assert "does not name its collimator" in remarks
    unknown = str(bench("{passport: p.json}", today=date(2026, 5, 31)).remarks)
    assert "the station does not state the temperature" in unknown
    assert "expired" not in unknown
    good = {"temperature_c": 20, "valid_until": "2026-06-01", "collimator": "C-1"}
    write(tmp_path / "a" / "p.json", **good, sealed_with=key)
    assert bench("{passport: p.json}", "serial: C-1, temperature_c: 25").remarks == ()
    write(tmp_path / "a" / "p.json", **good)
    (remark,) = bench("{passport: p.json}", "serial: C-1, temperature_c: 25").remarks
    assert "p.json is not sealed" in remark.message


@pytest.mark.usefixtures("own_home")
def test_the_plan_names_hash_and_seal_of_the_passport(bench, tmp_path, key):
    path = write(tmp_path / "a" / "p.json", collimator="C-1", sealed_with=key)
    plan = bench("{passport: p.json}")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"Passport p.json\n  SHA-256 {sha256}\n  sealed by {key.fingerprint}\n" in render_plan(plan)
    assert plan.passport.in_use.to_dict()["sealed_by"] == key.fingerprint
    write(tmp_path / "a" / "p.json", collimator="C-1")
    assert "\n  not sealed\n" in render_plan(bench("{passport: p.json}"))


def test_a_seal_of_a_key_that_is_not_trusted_is_remarked(bench, tmp_path, key, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "another"))
    write(tmp_path / "a" / "p.json", collimator="C-1", sealed_with=key)
    (remark,) = bench("{passport: p.json}").remarks
    assert f"sealed by {key.fingerprint}, a key that this bench does not trust" in remark.message


@pytest.mark.parametrize(("sealed", "trusted"), [(False, True), (True, False), (True, True)])
def test_a_strict_station_takes_sealed_passports_of_trusted_keys_only(
    bench, tmp_path, key, home, monkeypatch, sealed, trusted
):
    monkeypatch.setenv("STARBENCH_HOME", str(home if trusted else tmp_path / "another"))
    write(tmp_path / "a" / "p.json", collimator="C-1", sealed_with=key if sealed else None)
    plan = bench("{passport: p.json}", "serial: C-1, unsealed_passport: refuse")
    assert (plan.faults == ()) == (sealed and trusted)
    assert not plan.faults or "starbench passport seal" in plan.faults[0].message


def test_a_sealed_passport_that_was_changed_is_refused(bench, tmp_path, key):
    path = write(tmp_path / "a" / "p.json", collimator="C-1", sealed_with=key)
    path.write_text(path.read_text().replace("255.0", "254.0"))
    (fault,) = bench("{passport: p.json}").faults
    assert "was changed after it was sealed" in fault.message


@pytest.mark.usefixtures("own_home")
def test_conditions_that_people_wrote_do_not_break_a_plan(bench, tmp_path, key):
    wrong = {"temperature_c": "warm", "valid_until": "next year", "collimator": 17, "issued": [1]}
    write(tmp_path / "a" / "p.json", **wrong, sealed_with=key)
    plan = bench("{passport: p.json}", "serial: 17")
    assert (plan.faults, plan.remarks) == ((), ())
    assert plan.passport.in_use.to_dict()["temperature_c"] is None


def test_a_run_reads_the_copy_in_its_folder(bench, tmp_path):
    write(tmp_path / "a" / "p.json", 255, collimator="C-1")
    plan = bench("{passport: p.json}")
    run = tmp_path / "run"
    run.mkdir()
    for name, data in documents_of(plan).items():
        (run / name).write_bytes(data)
    assert sorted(documents_of(plan)) == [PASSPORT_COPY, SEQUENCE_COPY, STATION_COPY]
    (tmp_path / "a" / "p.json").unlink()
    again = Job.from_run_folder(run).plan
    assert again.passport.in_use.to_dict() == plan.passport.in_use.to_dict()
    assert again.passport.steps == plan.passport.steps
    (run / PASSPORT_COPY).unlink()
    missing = make_plan(
        *load_documents(str(run / SEQUENCE_COPY), str(run / STATION_COPY)), passport_copy=run / PASSPORT_COPY
    )
    assert "The run folder has no passport.json" in str(missing.faults)


def test_a_step_that_names_no_model_lets_the_data_choose(bench):
    bounded = GimbalReadings(({"pan_deg": 1.0},), 0.002, parallax=ParallaxBound(0, 0, 0, 1))
    for readings in (None, bounded):
        options = calibration_options(solve_of(bench()), None, readings)
        assert (options.model, options.gimbal) == ("auto", readings)


def test_the_plan_names_the_model_and_the_passport(bench):
    plan = bench("", f"serial: C-1, {CERTIFICATE}")
    assert "solve auto, k1 k2, huber, passport certificate" in render_plan(plan)
    assert plan.to_dict()["passport"]["number"] == "T-1"
    assert "solve auto, k1 k2, huber" in render_plan(bench())
    assert "solve spherical, k1 k2, huber" in render_plan(bench("{model: spherical}"))
    assert bench().to_dict()["passport"] is None


def test_the_planar_model_has_no_collimator_so_it_gets_no_passport(bench):
    step = solve_of(bench("{model: planar}"))
    assert calibration_options(step, Passport.of_radius(255, 0.05)).passport is None
