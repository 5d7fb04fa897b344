"""The lock files hold a version with its hashes for every dependency, within the range of pyproject.toml."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
FOR_DEVELOPERS = {"dev", "docs", "crosscheck"}
LOCKED = re.compile(r"^([A-Za-z0-9._-]+)(?:\[[^]]*\])?==(\S+)", re.MULTILINE)


def _project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def _wanted(extras: list[str]) -> list[Requirement]:
    project = _project()
    named = [
        *project["dependencies"],
        *(text for extra in extras for text in project["optional-dependencies"][extra]),
    ]
    return [Requirement(text) for text in named]


@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        ("requirements.lock", []),
        ("requirements-all.lock", sorted(_project()["optional-dependencies"].keys() - FOR_DEVELOPERS)),
        ("requirements-dev.lock", ["dev"]),
        ("requirements-docs.lock", ["docs"]),
    ],
)
def test_the_lock_has_a_version_of_every_dependency_within_its_range(lock, extras):
    versions: dict[str, list[str]] = {}
    for name, version in LOCKED.findall((ROOT / lock).read_text()):
        versions.setdefault(canonicalize_name(name), []).append(version)
    wanted = _wanted(extras)
    assert len(wanted) > 10
    outside = {
        str(requirement) for requirement in wanted if not versions.get(canonicalize_name(requirement.name))
    }
    outside |= {
        str(requirement)
        for requirement in wanted
        for each in versions.get(canonicalize_name(requirement.name), ())
        if each not in requirement.specifier
    }
    assert outside == set(), "run: make lock"


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-all.lock", "requirements-dev.lock"])
def test_every_locked_file_is_known_by_its_hash_and_none_by_an_address(lock):
    text = (ROOT / lock).read_text()
    packages = re.split(r"^(?=[a-zA-Z0-9])", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in package for package in packages)
    assert "://" not in text
