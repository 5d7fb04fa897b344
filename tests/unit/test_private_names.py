"""No test imports or patches a private name of ours; that none takes one of an object is SLF001 of the linter."""

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
OURS = r"(?:bench|calib|drivers|sequences|simulators)\b[\w.]*"
REACHES = re.compile(
    rf'from {OURS} import [^#\n]*\b_[a-z]|"{OURS}\._[a-z]|\.(?:setattr|object)\((?!serial)[\w.]+, "_[a-z]'
)


def test_tests_use_public_names_alone():
    found = [(path.name, REACHES.findall(path.read_text(encoding="utf-8"))) for path in TESTS.rglob("*.py")]
    assert [each for each in found if each[1]] == []
