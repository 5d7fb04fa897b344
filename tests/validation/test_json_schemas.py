"""The exported JSON Schemas, asked of a validator nobody here wrote: they and the strict reader agree."""

import re
from pathlib import Path
from typing import Any

import pytest
from filled_stations import filled

from bench.stations.station import Station
from sequences.errors import DocumentFaults
from sequences.reader import check_document
from sequences.schema import Sequence
from sequences.yaml_text import parse

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema, the second opinion, is not installed")

ROOT = Path(__file__).parents[2]
FILES = {
    Sequence: sorted((ROOT / "sequences").glob("*.yaml")),
    Station: sorted((ROOT / "bench/stations").glob("*.yaml")),
}
DOCUMENTS = [(model, path) for model, paths in FILES.items() for path in paths]

WRONG = {
    Sequence: [
        ("- light\n", "- lihgt\n"),
        ("- light\n", "- wait\n"),
        ("- light\n", "- {light: of}\n"),
        ("- light\n", "- {light: {}, move: {}}\n"),
        ("- light\n", "- {light: {frequency_hz: sixty}}\n"),
        ("- light\n", "- {record: {attempts: 0}}\n"),
        ("name: ", "nam: "),
        ("format: starbench/sequence/1", "format: starbench/station/1"),
        ("image: auto", "image: best"),
    ],
    Station: [
        ("driver: scpi", "driver: scpy"),
        ("    pan:", "    yaw:"),
        ("device: 1", "device: 0"),
        ("camera:\n", "camera:\n  bias: {}\n"),
        ("name: ", "nam: "),
    ],
}


def as_an_editor_sees_it(value: Any) -> Any:
    """Texts as the numbers and truths of YAML's core schema."""
    if isinstance(value, dict):
        return {key: as_an_editor_sees_it(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [as_an_editor_sees_it(inner) for inner in value]
    if isinstance(value, str) and re.fullmatch(r"[-+]?[0-9]+", value):
        return int(value)
    if isinstance(value, str) and re.fullmatch(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", value):
        return float(value)
    return {"true": True, "false": False}.get(value, value) if isinstance(value, str) else value


def accepted_by_the_schema(text: str, model) -> bool:
    validator = jsonschema.Draft202012Validator(model.model_json_schema())
    return validator.is_valid(as_an_editor_sees_it(parse(text.encode(), "f").value))


def accepted_by_the_reader(text: str, model) -> bool:
    try:
        check_document(text.encode(), "f", model)
    except DocumentFaults:
        return False
    return True


@pytest.mark.parametrize("model", [Sequence, Station])
def test_each_schema_is_a_valid_json_schema(model):
    jsonschema.Draft202012Validator.check_schema(model.model_json_schema())


@pytest.mark.parametrize(("model", "path"), DOCUMENTS, ids=lambda value: getattr(value, "stem", ""))
def test_what_is_shipped_is_accepted_by_schema_and_reader(model, path):
    text = path.read_text(encoding="utf-8")
    assert accepted_by_the_reader(text, model)
    if path.stem.startswith("example_"):  # an editor marks the values that are still to be filled in
        assert not accepted_by_the_schema(text, model)
        text = filled(text)
        assert accepted_by_the_reader(text, model)
    assert accepted_by_the_schema(text, model)


@pytest.mark.parametrize(
    ("model", "old", "new"),
    [(model, old, new) for model, wrongs in WRONG.items() for old, new in wrongs],
    ids=lambda value: repr(value)[:30],
)
def test_what_is_wrong_is_refused_by_schema_and_reader(model, old, new):
    text = FILES[model][-1].read_text(encoding="utf-8")
    assert old in text
    text = text.replace(old, new, 1)
    assert not accepted_by_the_schema(text, model)
    assert not accepted_by_the_reader(text, model)


def test_what_stands_below_a_key_describes_it_in_the_schema_also_of_a_model_that_inherits_the_key():
    defined = Station.model_json_schema()["$defs"]
    assert defined["ZaberAxisConfig"]["properties"]["device"]["description"] == "Address in the chain."
    assert "controller is 0" in defined["ZaberAxisConfig"]["properties"]["zero_deg"]["description"]
