"""A sealed run of the simulated bench, made once, and copies of it that can be changed and sealed again."""

import pytest
from authorising import Authority, make_key, person
from shared_folder import shared_folder

from bench.evidence.keys import load_key
from bench.evidence.signers import read_signers
from bench.plan.job import Job
from tests.unit.bench.evidence.attacked_run import kept_in_memory, make_run
from tests.unit.bench.evidence.resealed import Forger, copied


@pytest.fixture
def made_once():
    with kept_in_memory():
        yield


@pytest.fixture(scope="session")
def run_once(tmp_path_factory):
    """A sealed run of a simulated bench, not to be touched."""
    return (
        shared_folder(tmp_path_factory, "attacked", lambda folder: make_run(folder, folder / "home")) / "run"
    )


@pytest.fixture(scope="session")
def bench_home(run_once):
    return run_once.with_name("home")


@pytest.fixture(scope="session")
def bench_key(run_once, bench_home):
    return load_key(bench_home)


@pytest.fixture(scope="session")
def trusted(run_once, bench_home):
    return read_signers(bench_home / "allowed_signers")


@pytest.fixture(scope="session")
def job(run_once):
    return Job.from_run_folder(run_once, seed=1, operator="Ada")


@pytest.fixture
def forger(run_once, bench_key, tmp_path):
    """A copy of the run, and the key to seal it again."""
    return Forger(copied(run_once, tmp_path / "run"), bench_key)


@pytest.fixture(scope="session")
def ada(tmp_path_factory):
    """A person's key, and the line that trusts it."""
    return person(make_key(tmp_path_factory.mktemp("ada")))


@pytest.fixture(scope="session")
def authority(tmp_path_factory):
    """A time stamping authority."""
    return Authority.create(tmp_path_factory.mktemp("tsa") / "tsa")
