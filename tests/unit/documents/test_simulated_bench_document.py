"""What a reader copies from the document on the simulated bench works."""

import re
from pathlib import Path

import pytest
import yaml

from simulators.config import bench_config
from simulators.faults.catalogue import fault_order, fault_order_from_text

TEXT = (Path(__file__).parents[3] / "docs" / "simulated-bench.md").read_text(encoding="utf-8")
EXAMPLES = [
    example["simulation"]
    for example in map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", TEXT, flags=re.DOTALL))
    if "simulation" in example
]


@pytest.mark.parametrize("section", EXAMPLES, ids=" ".join)
def test_an_example_is_a_valid_configuration(section):
    faults = [fault_order(order) for order in section.get("faults", [])]
    assert list(bench_config(section).faults) == faults


def test_the_example_orders_are_valid():
    block = TEXT.split("answered by a line of JSON:\n\n```\n", 1)[1].split("```", 1)[0].splitlines()
    read = {True: lambda line: fault_order(yaml.safe_load(line)), False: fault_order_from_text}
    orders = [read[line.startswith("{")](line) for line in block]
    assert [order.fault for order in orders] == ["stall", "late", "wrong_frequency"]
