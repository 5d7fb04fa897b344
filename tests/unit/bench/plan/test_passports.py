"""The passport of a run: which file the documents name, what is wrong with it, and what speaks against it."""

import hashlib
import json
import shutil
import subprocess
from datetime import date

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from station_texts import PLAIN, without

from bench.base.errors import EvidenceError, UsageError
from bench.evidence.passport_seal import read_passport_seal, seal_passport
from bench.plan.job import Job, calibration_options, documents_of
from bench.plan.passport_file import parse_passport, passport_bytes, read_passport_file
from bench.plan.plan import load_documents, make_plan
from bench.record.run_folder import PASSPORT_COPY, PLAN, SEQUENCE_COPY, STATION_COPY
from bench.solve.passports import seal_file, sealed_bytes, seals_of
from bench.wording.plan_text import render_plan
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

    def plan(solve: str = "", collimator: str = "serial: C-1", settings=None, *, more=MORE, **options):
        (tmp_path / "a" / "s.yaml").write_text(SEQUENCE % (more, f": {solve}" if solve else ""))
        station = without(PLAIN, "collimator") + f"collimator: {{{collimator}}}\n"
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
    assert "only one direction" in texts(bench(more="").faults)[0]
    write(tmp_path / "a" / "p.json", collimator="C-1")
    assert "only one direction" in texts(bench("{passport: p.json}", more="").faults)[0]
    (tmp_path / "a" / "p.json").write_text(json.dumps(passport(np.eye(3)).to_dict()))
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
    used = plan.passport.in_use.to_dict()
    stated = {"source": "station certificate", "collimator": "C-1", "number": "T-1", "values": {"r": 255.0}}
    stated |= {"valid_until": "2027-01-01", "sigma": {"r": pytest.approx(0.05)}}
    assert used | stated == used
    assert plan.remarks == ()
    assert calibration_options(solve_of(plan), plan.passport_for(solve_of(plan))).model == "auto"


def test_the_sequence_wins_over_the_station_and_none_switches_it_off(bench, tmp_path):
    write(tmp_path / "a" / "p.json", 256, collimator="C-1")
    named = bench("{passport: p.json}", f"serial: C-1, {CERTIFICATE}")
    assert named.passport.in_use.passport.values_by_name == {"r": 256.0}
    assert bench("{passport: none}", f"serial: C-1, {CERTIFICATE}").passport.in_use is None
    for model in ("spherical", "planar"):
        assert bench(f"{{model: {model}}}", f"serial: C-1, {CERTIFICATE}").passport.in_use is None
        assert "method of reference" in str(bench(f"{{model: {model}, passport: p.json}}").faults)


RADIUS = Passport.of_radius(255.0, 0.05).to_dict()
WOBBLE = {"names": ["r", "wobble"], "values": [255, 1], "covariance": [[1, 0], [0, 1]]}


@pytest.mark.parametrize(
    ("content", "fault_text"),
    [
        (None, "There is no such passport file."),
        ("{}\r\n", "its lines end in CR LF"),
        ("\xff", "get the original again"),
        ('{"schema": "starbench/results/1"}', "schema is 'starbench/results/1'"),
        ("1" * 1_000_001, "more than 1000000 bytes"),
        (json.dumps(RADIUS | {"values": [-255.0]}), "radius r is not positive"),
        (json.dumps(RADIUS | WOBBLE | {"reference": [1, 2, 3]}), "names.1 is 'wobble'"),
    ],
)
def test_a_file_that_is_no_passport_is_a_fault_where_it_is_named(bench, tmp_path, content, fault_text):
    if content is not None:
        (tmp_path / "a" / "p.json").write_text(content, encoding="latin-1")
    (fault,) = bench("{passport: p.json}").faults
    assert (fault.line, fault.column, fault.path) == (12, 23, "steps[8].solve.passport")
    assert fault_text in fault.message
    (tmp_path / "a" / "folder").mkdir()
    assert "This is a folder" in str(bench("{passport: folder}").faults)


def test_a_passport_of_another_collimator_is_a_fault_unless_it_is_accepted(bench, tmp_path):
    write(tmp_path / "a" / "p.json", collimator="C-2")
    (fault,) = bench("{passport: p.json}").faults
    assert all(serial in fault.message for serial in ("C-1", "C-2"))
    accepted = bench("{passport: p.json, other_collimator: accept}")
    assert accepted.faults == ()
    assert "belongs to the collimator C-2" in str(accepted.remarks)


@pytest.mark.usefixtures("own_home")
def test_what_speaks_against_a_passport_is_remarked(bench, tmp_path, key):
    write(tmp_path / "a" / "p.json", temperature_c=20, valid_until="2026-05-31")
    remarks = str(bench("{passport: p.json}", "serial: C-1, temperature_c: 26").remarks)
    for fact in ("expired on 2026-05-31", "26 °C, 6 °C apart", "does not name its collimator"):
        assert fact in remarks
    unknown = str(bench("{passport: p.json}", today=date(2026, 5, 31)).remarks)
    assert "state the temperature" in unknown
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
    assert f"sealed by {key.fingerprint}" in remark.message


@pytest.mark.parametrize(("sealed", "trusted"), [(False, True), (True, False), (True, True)])
def test_a_strict_station_takes_sealed_passports_of_trusted_keys_only(
    bench, tmp_path, key, home, monkeypatch, sealed, trusted
):
    monkeypatch.setenv("STARBENCH_HOME", str(home if trusted else tmp_path / "another"))
    write(tmp_path / "a" / "p.json", collimator="C-1", sealed_with=key if sealed else None)
    plan = bench("{passport: p.json}", "serial: C-1, unsealed_passport: refuse")
    assert (plan.faults == ()) == (sealed and trusted)
    assert not plan.faults or "starbench passport show" in plan.faults[0].message


def test_a_run_reads_the_copy_in_its_folder(bench, tmp_path):
    write(tmp_path / "a" / "p.json", 255, collimator="C-1")
    plan = bench("{passport: p.json}")
    run = tmp_path / "run"
    run.mkdir()
    for name, data in documents_of(plan).items():
        (run / name).write_bytes(data)
    assert sorted(documents_of(plan)) == [PASSPORT_COPY, PLAN, SEQUENCE_COPY, STATION_COPY]
    (tmp_path / "a" / "p.json").unlink()
    again = Job.from_run_folder(run).plan
    assert again.passport.in_use.to_dict() == plan.passport.in_use.to_dict()
    assert again.passport.steps == plan.passport.steps
    (run / PASSPORT_COPY).unlink()
    missing = make_plan(
        *load_documents(str(run / SEQUENCE_COPY), str(run / STATION_COPY)), passport_copy=run / PASSPORT_COPY
    )
    assert "no passport.json" in str(missing.faults)


# ---------------------------------------------------------------- passport files

NAMES = ("x", "y", "r")

SIGMA = np.array([0.03, 0.04, 0.05])


def passport(covariance=None, values=(97.0, 141.0, 255.0)):
    covariance = np.diag(SIGMA**2) if covariance is None else covariance
    return Passport(NAMES, np.array(values), covariance, conditions={"collimator": "C-1"})


def altered(**fields):
    return json.dumps(passport().to_dict() | fields).encode()


def test_stock_tools_check_the_seal_as_the_documentation_says(tmp_path, key, home):
    if shutil.which("ssh-keygen") is None:
        pytest.skip("ssh-keygen is not installed")
    sealed = seal_passport(passport_bytes(passport()), key)

    def accepted(data):
        (tmp_path / "collimator.json").write_bytes(data)
        script = r"""
            sed -n 's/^ "seal": "\\(.*\\)",$/\\1/p' collimator.json | sed 's/\\\\n/\\n/g' > seal.sig
            grep -v '^ "seal": ' collimator.json |
                ssh-keygen -Y verify -f "$0" -I bench1@lab.example -n starbench-report@v1 -s seal.sig
        """.replace("\\\\", "\\")
        words = ["bash", "-c", script, str(home / "allowed_signers")]
        return subprocess.run(words, cwd=tmp_path, capture_output=True, check=False).returncode == 0

    assert accepted(sealed)
    assert not accepted(sealed.replace(b"255.0", b"255.1"))


@given(st.data())
def test_no_byte_of_a_sealed_passport_can_be_changed(key, data):
    sealed = bytearray(seal_passport(passport_bytes(passport()), key))
    place = data.draw(st.integers(0, len(sealed) - 1))
    sealed[place] ^= data.draw(st.integers(1, 255))
    try:
        passport_seal = read_passport_seal(bytes(sealed))
    except EvidenceError:
        return
    if passport_seal is not None:  # the changed byte is not within what base64 counts
        raise AssertionError(bytes(sealed[place - 20 : place + 20]))
    with pytest.raises(UsageError):
        parse_passport(bytes(sealed), "p")


@pytest.mark.parametrize("indent", [None, 1, 2])
def test_a_sealed_passport_written_anew_by_another_program_is_refused(key, indent):
    sealed = seal_passport(passport_bytes(passport()), key)
    document = json.loads(sealed)
    document["covariance"][2][2] /= 1e4
    with pytest.raises(UsageError, match=r"sealed|second line"):
        parse_passport((json.dumps(document, indent=indent) + "\n").encode(), "p")
    moved = {name: document[name] for name in sorted(document)}
    with pytest.raises(UsageError, match="second line"):
        parse_passport((json.dumps(moved, indent=1) + "\n").encode(), "p")


@pytest.mark.parametrize(
    ("covariance", "says"),
    [
        (np.zeros((3, 3)), "variance of x in its covariance is 0"),
        (np.diag([1e-3, 1e-3, (255e-9) ** 2]), "variance of r"),
        (np.diag([1e-3, 1e-3, -1e-3]), "positive semidefinite|variance"),
        (np.diag([1e-3, 1e-3, 1e300]), r"covariance\.2\.2 is 1e\+300"),
        (np.array([[1e-9, 0, 5e-10], [0, 1e-9, 0], [0, 0, 1e-9]]), "not symmetric"),
    ],
)
def test_a_covariance_that_no_measurement_gives_is_refused(covariance, says):
    with pytest.raises(UsageError, match=says):
        parse_passport(altered(covariance=covariance.tolist()), "p")


@pytest.mark.parametrize("values", [[97, 141, 0], [97, 141, 10**400]])
def test_values_that_no_collimator_has_are_refused(values):
    with pytest.raises(UsageError):
        parse_passport(altered(values=values), "p")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"conditions": {', r'"conditions": {"laboratory": "\ud800",', "surrogates"),
        ("255.0", "1e999", r"values\.2 is inf"),
        ('"disagreement": 1', '"disagreement": -1', "disagreement is -1"),
        ('"y"', '"x"', "2 parameters"),
    ],
)
def test_json_that_readers_take_differently_is_refused(old, new, says):
    with pytest.raises(UsageError, match=says):
        parse_passport(altered().replace(old.encode(), new.encode(), 1), "p")


def test_a_passport_without_a_seal_gets_one_in_a_new_file(tmp_path, key):
    (tmp_path / "hand.json").write_bytes(altered())
    seal_file(tmp_path / "hand.json", tmp_path / "sealed.json", key)
    data = (tmp_path / "sealed.json").read_bytes()
    assert read_passport_seal(data).fingerprint == key.fingerprint
    assert read_passport_file(tmp_path / "sealed.json")[0].to_dict() == passport().to_dict()
    with pytest.raises(UsageError, match="sealed already"):
        seal_file(tmp_path / "sealed.json", tmp_path / "again.json", key)
    (tmp_path / "plain.json").write_bytes(sealed_bytes(passport()))
    assert read_passport_seal((tmp_path / "plain.json").read_bytes()) is None


def test_a_passport_names_the_seals_of_its_runs(sealed_once, tmp_path):
    seals = seals_of([sealed_once, tmp_path, tmp_path / "points.csv"])
    assert seals == {"sealed": hashlib.sha256((sealed_once / "SHA256SUMS").read_bytes()).hexdigest()}
