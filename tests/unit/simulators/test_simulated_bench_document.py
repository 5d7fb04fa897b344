"""The document on the simulated bench lists every fault and kind of device, and its examples are valid."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from simulators.config import LIGHT_KINDS, STAGE_KINDS, bench_config
from simulators.faults.catalogue import fault_order, fault_order_from_text, faults_of
from simulators.world.gimbal import GimbalTruth
from simulators.world.truth import COLLIMATORS, CollimatorTruth, LensTruth, MountTruth, ReticleTruth

TEXT = (Path(__file__).parents[3] / "docs" / "simulated-bench.md").read_text(encoding="utf-8")


def names_in_first_column(title: str, name: str = r"`(\w+)`") -> set[str]:
    section = re.split(r"^##+ ", TEXT.split(f"\n### {title}", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    cells = [line.split("|")[1] for line in section.splitlines() if line.startswith("|")]
    return {word for cell in cells for word in re.findall(name, cell)}


@pytest.mark.parametrize(
    ("title", "device"),
    [
        ("Of an axis", "pan"),
        ("Of a line", "gimbal"),
        ("Of the camera", "camera"),
        ("Of the mount", "mount"),
        ("Of the lens", "lens"),
    ],
)
def test_every_fault_stands_in_its_table(title, device):
    assert names_in_first_column(title) == set(faults_of(device))


def test_every_fault_of_the_light_stands_in_its_table():
    of_the_line = set(faults_of("gimbal"))
    assert names_in_first_column("Of the light") == set(faults_of("light")) - of_the_line


def test_every_kind_of_device_is_documented():
    kinds = set(re.findall(r"^\| `(\w+)` \|", TEXT.split("\n## How a stage moves")[0], flags=re.MULTILINE))
    assert kinds == {*STAGE_KINDS, *LIGHT_KINDS}


def test_every_collimator_stands_in_the_table_of_profiles():
    assert names_in_first_column("Collimators by name", r"`([\w-]+)`") >= set(COLLIMATORS)


@pytest.mark.parametrize("section", [GimbalTruth, ReticleTruth, MountTruth, CollimatorTruth, LensTruth])
def test_every_key_of_collimator_reticle_mount_and_gimbal_is_documented(section):
    words = set(re.findall(r"\w+", TEXT))
    assert {field.name for field in fields(section)} <= words


def test_the_example_is_a_valid_configuration():
    example = re.search(r"```yaml\n(.*?)```", TEXT, flags=re.DOTALL)
    assert example
    config = bench_config(yaml.safe_load(example[1])["simulation"])
    assert config.faults == (fault_order({"device": "pan", "fault": "stall", "skip": 3}),)


def test_the_example_orders_are_valid():
    block = TEXT.split("answered by a line of JSON:\n\n```\n", 1)[1].split("```", 1)[0].splitlines()
    orders = [
        fault_order(yaml.safe_load(line)) if line.startswith("{") else fault_order_from_text(line)
        for line in block
    ]
    assert [order.fault for order in orders] == ["stall", "late", "wrong_frequency"]
