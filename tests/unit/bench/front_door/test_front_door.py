"""The package `starbench`: quick to import, complete, and closed to foreign packages with the names of ours."""

import json
import re
import sys
from pathlib import Path

import pytest
from running import python

import bench.front_door
from bench.front_door import ForeignPackageError
from bench.front_door.own_packages import PACKAGES, require_own_packages
from bench.solve.run_reader import Pose, Run, load

ROOT = Path(__file__).parents[4]
DOORS = {"command": ["-c", "import starbench; starbench.main()"], "module": ["-m", "bench"]}


def run(door, folder, *words, status=0):
    """Start the program outside the checkout, where ``folder`` comes first on Python's path."""
    return python(*DOORS[door], *words, status=status, cwd=folder, PYTHONPATH=folder)


def foreign(folder, name):
    """A package of another project, which says so when it is imported."""
    (folder / name).mkdir()
    (folder / name / "__init__.py").write_text("print('FOREIGN')\n")
    return folder / name


def test_import_starbench_gives_the_reader_of_runs():
    import starbench

    assert starbench.load is load
    assert (starbench.Run, starbench.Pose) == (Run, Pose)
    assert set(dir(starbench)) == set(starbench.__all__)


def test_the_installed_copy_is_the_front_door_as_it_is_now():
    import starbench

    for path in Path(bench.front_door.__file__).parent.glob("*.py"):
        assert (Path(starbench.__file__).parent / path.name).read_text() == path.read_text(), "install again"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        bench.front_door.lod  # noqa: B018


def test_the_front_door_is_imported_without_numpy_and_load_without_the_engine():
    code = (
        "import sys, starbench; assert 'numpy' not in sys.modules; starbench.load; "
        "assert not {'calib.engine', 'h5py', 'cv2', 'numba', 'scipy'} & set(sys.modules)"
    )
    python("-c", code)


@pytest.mark.parametrize(
    ("door", "name"), [("command", "bench"), ("command", "simulators"), ("module", "calib")]
)
def test_a_foreign_package_is_named_and_never_imported(door, name, tmp_path):
    place = foreign(tmp_path, name)
    done = run(door, tmp_path, "--version", status=1)
    assert done.stdout == ""
    assert re.match(rf"starbench: .*{name!r}: {re.escape(str(place))}", done.stderr)
    assert f"Starbench is in {ROOT}" in done.stderr or "site-packages" in done.stderr
    assert f"remove {tmp_path} from PYTHONPATH" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_foreign_module_in_one_file_is_refused_too(tmp_path):
    (tmp_path / "calib.py").write_text("print('FOREIGN')\n")
    done = run("command", tmp_path, "runs", "--json", status=1)
    error = json.loads(done.stdout)["error"]
    assert error["kind"] == "ForeignPackageError"
    assert str(tmp_path / "calib.py") in error["message"]
    assert "virtual environment" in error["remedy"]


def test_a_folder_that_is_no_package_does_no_harm(tmp_path):
    (tmp_path / "drivers").mkdir()
    done = run("command", tmp_path, "--version")
    assert done.stdout.startswith("starbench, version")


def test_a_notebook_with_a_foreign_package_gets_an_import_error(tmp_path, monkeypatch):
    foreign(tmp_path, "simulators")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "simulators", raising=False)
    with pytest.raises(ForeignPackageError, match="another package named 'simulators'"):
        require_own_packages()


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    for name in PACKAGES[1:]:
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    monkeypatch.setattr(sys, "meta_path", [f for f in sys.meta_path if "ditable" not in repr(f)])
    with pytest.raises(ForeignPackageError, match="missing"):
        require_own_packages()
