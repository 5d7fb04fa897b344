"""The documents about sequences and stations: every example in them is one that works."""

import re
from pathlib import Path

import pytest
import yaml
from flat import flatten
from station_texts import PLAIN, station_of, without

from bench.plan.plan import load_documents, make_plan
from bench.stations.station import Station
from bench.stations.station_fields import DrawingConfig, TargetConfig
from sequences.queue import JobConfig, Queue
from sequences.reader import check_document
from sequences.schema import (
    DefaultConfig,
    FlickerConfig,
    GateConfig,
    RecordConfig,
    Sequence,
    SettleConfig,
    StepConfig,
)
from sequences.solve_schema import LimitConfig, SolveConfig

ROOT = Path(__file__).parents[3]
DOCS = {
    name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("sequences", "stations", "extras/tools/check")
}
EXAMPLES = [
    (name, text)
    for name, document in DOCS.items()
    for text in re.findall(r"```yaml\n(.*?)```", document, re.DOTALL)
]
SETTINGS = (FlickerConfig, SettleConfig, GateConfig, RecordConfig, SolveConfig, LimitConfig, DefaultConfig)
SCRIPT = "format: starbench/sequence/1\nname: x\nsteps: [light]\n"


@pytest.mark.parametrize(("name", "text"), EXAMPLES, ids=lambda text: text[:40])
def test_an_example_in_the_documents_is_read_without_a_fault(name, text):
    if name == "stations":
        if not text.startswith("format"):
            sections = [name for name in yaml.safe_load(text) if f"\n{name}:" in PLAIN]
            text = without(PLAIN, *sections) + text
        assert station_of(text).stage.axes
    else:
        head = SCRIPT.partition("steps")[0] if text.startswith("steps") else SCRIPT
        whole = text if text.startswith("format") else head + text
        assert flatten(check_document(whole.encode(), "example", Sequence))


def test_the_sequence_shown_whole_is_the_one_shipped():
    shown = next(text for name, text in EXAMPLES if name == "sequences" and text.startswith("format"))
    shipped = yaml.safe_load((ROOT / "sequences" / "three_pose.yaml").read_text(encoding="utf-8"))
    shipped.pop("description")
    assert yaml.safe_load(shown) == shipped


def test_every_word_of_the_language_is_in_the_table_of_steps():
    table = DOCS["sequences"].partition("| Step |")[2].partition("\n\n")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == list(StepConfig.model_fields)


def names_in(schema):
    """Names of the settings of a schema, and of all that it holds."""
    for part in (schema, *schema.get("$defs", {}).values()):
        for name, inner in part.get("properties", {}).items():
            yield name
            yield from names_in(inner)


PLANNED = make_plan(*load_documents("three_pose", "simulated")).to_dict()
NAMES = {
    "sequences": {
        *(name for words in SETTINGS for name in words.model_fields),
        *(f"`{name}`" for part in (PLANNED, PLANNED["poses"][0], PLANNED["steps"][1]) for name in part),
        *("`line`", "`column`", "`path`", "`message`"),
    },
    "stations": set(names_in(Station.model_json_schema())),
    "batches": {*Queue.model_fields, *JobConfig.model_fields},
}


@pytest.mark.parametrize("page", NAMES)
def test_every_setting_and_every_key_of_a_plan_is_named_in_its_document(page):
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert sorted(name for name in NAMES[page] if name not in text) == []


def test_every_key_of_a_target_is_explained_in_its_document():
    document = (ROOT / "docs" / "target.md").read_text(encoding="utf-8")
    drawing = (ROOT / "docs" / "pictures" / "target-keys.svg").read_text(encoding="utf-8")
    for key in (*TargetConfig.model_fields, *DrawingConfig.model_fields):
        assert f"| `{key}` |" in document or key == "drawing", key
        shown = key in drawing or key in {"description", "units", "mirrored", "drawing"}
        assert shown, key
    example = re.search(r"```yaml\n(target:\n.*?)```", document, re.DOTALL)
    assert station_of(PLAIN + example[1]).target.serial == "R-7"
