"""From a file to a checked document: places, words and completeness of faults; files that cannot be read."""

import os
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field
from refusals import faults_of

from sequences.errors import DocumentFaults
from sequences.reader import check_document, find_document, read_document
from sequences.schema import Sequence
from sequences.strict_model import StrictModel
from sequences.yaml_text import MOST_BYTES


class Lamp(StrictModel):
    kind: Literal["lamp"]
    watts: Annotated[float, Field(gt=0)]


class Laser(StrictModel):
    kind: Literal["laser"]
    serial: str
    on: bool = False


class Table(StrictModel):
    format: Literal["test/1"]
    light: Annotated[Lamp | Laser, Field(discriminator="kind")]
    legs: dict[str, tuple[int, int]] = Field(default_factory=dict)


def faults(text: str, model=Table) -> list[str]:
    return faults_of(check_document, text.encode(), "t.yaml", model)


def test_a_document_keeps_its_bytes_and_its_places():
    data = b"format: test/1\nlight:\n  kind: laser\n  serial: 00051234 # zeros count\n  on: yes\n"
    document = check_document(data, "t.yaml", Table)
    assert document.value.light == Laser(kind="laser", serial="00051234", on=True)
    assert document.text == data
    assert document.tree.spot(("light", "serial")) == (4, 11)
    assert document.where(("light", "serial")) == "t.yaml:4:11"
    assert str(document.fault(("light", "on"), "no.")) == "t.yaml:5:7: light.on: no."


def test_every_fault_is_reported_at_once_in_the_order_of_the_file():
    assert faults(
        "format: test/1\nlihgt: 1\nlight: {kind: lamp, wats: 3}\nlegs:\n  a: [1, x]\n  b: [1.5, 2]\n  a: 2\n"
    ) == [
        "t.yaml:2:1: lihgt: unknown key. Did you mean 'light'?",
        "t.yaml:3:8: light.watts: this key is required, but it is missing.",
        "t.yaml:3:21: light.wats: unknown key. Did you mean 'watts'?",
        "t.yaml:5:10: legs.a[1]: must be a whole number (got 'x').",
        "t.yaml:6:7: legs.b[0]: must be a whole number (got '1.5').",
        "t.yaml:7:3: legs.a: duplicate key; the first one is in line 5.",
    ]


def test_an_unknown_kind_is_met_with_the_known_ones():
    assert faults("format: test/1\nlight: {kind: candle}\n") == [
        "t.yaml:2:15: light.kind: must be one of 'lamp', 'laser' (got 'candle')."
    ]
    assert faults("format: test/1\nlight: {watts: 3}\n") == [
        "t.yaml:2:8: light.kind: must be one of 'lamp', 'laser', but it is missing."
    ]


@pytest.mark.parametrize(
    ("light", "place", "fact"),
    [
        ("{kind: lamp, watts: sixty}", "light.watts", "a number (got 'sixty')."),
        ("{kind: lamp, watts: inf}", "light.watts", "finite number (got 'inf')."),
        ("{kind: lamp, watts: '2,5'}", "light.watts", "(got '2,5'). Write a decimal point."),
        ("{kind: lamp, watts: '1,250'}", "light.watts", "no mark between thousands."),
        ("{kind: lamp, watts: 60 W}", "light.watts", "(got '60 W'). Write the number alone"),
        ("{kind: lamp, watts: 5 %}", "light.watts", "1 % is 0.01."),
        ("{kind: lamp, watts: 20ppm}", "light.watts", "1 ppm is 1e-6."),
        ("{kind: lamp, watts: \u22125}", "light.watts", "Write the minus sign"),
        ("{kind: lamp, watts: 2,5}", "light.5", "unknown key. Write a decimal point"),
        ("{kind: lamp, watts: -1}", "light.watts", "more than 0 (got '-1')."),
        ("{kind: lamp, watts: 0e0}", "light.watts", "more than 0 (got '0e0')."),
        ("{kind: laser, serial: {a: b}}", "light.serial", "must be text."),
        ("{kind: laser, serial: x, on: maybe}", "light.on", "true or false (got 'maybe')."),
        ("x", "light", "(key: value) (got 'x')."),
    ],
)
def test_a_wrong_value_is_met_in_plain_words_with_what_was_got(light, place, fact):
    (message,) = faults(f"format: test/1\nlight: {light}\n")
    assert message.partition(": ")[2].startswith(f"{place}: ")
    assert fact in message


@pytest.mark.parametrize(
    "text", ["074", "6_0", "-01", "00", "0_5", "1_000.5", "' 7'", "'7 '", "01e2", "1e0_1"]
)
def test_a_number_is_a_plain_decimal_number(text):
    (fault,) = faults(f"format: test/1\nlight: {{kind: lamp, watts: {text}}}\n")
    assert "light.watts: " in fault
    assert text.strip("'") in fault
    (fault,) = faults(f"format: test/1\nlight: {{kind: laser, serial: 1}}\nlegs: {{a: [{text}, 1]}}\n")
    assert "legs.a[0]: " in fault


@pytest.mark.parametrize(
    ("text", "watts"), [("0.5", 0.5), (".5", 0.5), ("+5", 5), ("5.", 5), ("1e-3", 0.001)]
)
def test_plain_numbers_are_read_as_ever(text, watts):
    read = check_document(f"light: {{kind: lamp, watts: {text}}}\nformat: test/1".encode(), "t", Table)
    assert read.value.light.watts == watts


def test_a_serial_number_that_looks_like_an_odd_number_stays_text():
    read = check_document(b"format: test/1\nlight: {kind: laser, serial: 0074_1}\n", "t.yaml", Table)
    assert read.value.light.serial == "0074_1"


def test_quotes_of_a_word_processor_do_not_become_a_part_of_a_serial_number():
    assert faults("format: test/1\nlight: {kind: laser, serial: \u201e00051234\u201c}\n") == [
        't.yaml:2:30: light.serial: typographic quotes (\u201e) would be a part of the text: write ".'
    ]


def test_an_unknown_key_is_compared_with_the_keys_of_its_own_kind_only():
    assert faults("format: test/1\nlight: {kind: lamp, watts: 1, serail: x}\n") == [
        "t.yaml:2:31: light.serail: unknown key. Known here: kind, watts."
    ]


@pytest.mark.parametrize("text", ["", "# nothing\n", "[a, b]\n", "word\n"])
def test_what_is_no_mapping_is_one_fault(text):
    (message,) = faults(text)
    assert message.startswith("t.yaml:1:1: ")


def test_a_file_of_another_program_is_one_fault_and_a_forgotten_format_hides_no_other():
    (message,) = faults("cam0:\n  camera_model: pinhole\nrostopic: /events\n", Sequence)
    assert message.startswith(
        "t.yaml:1:1: format: this is a file of something else: it has no 'format: starbench/sequence/1'"
    )
    both = faults("name: x\nstep: [light]\nposes: {}\n", Sequence)
    assert [each.partition(": ")[2].partition(":")[0] for each in both] == ["format", "steps", "step"]


def test_a_document_of_another_kind_is_one_fault_not_one_a_line():
    (message,) = faults("format: starbench/station/1\nname: x\nstage: {}\n", Sequence)
    assert message.startswith("t.yaml:1:9: format: wrong kind of document")
    assert message.endswith(
        "a sequence is needed here, and this is a station file. Name a station file with --station."
    )


def test_a_document_of_an_unknown_version_is_named_by_its_format():
    (message,) = faults("format: starbench/sequence/9\nname: x\n", Sequence)
    assert message.endswith("'starbench/sequence/1' is needed here (got 'starbench/sequence/9').")


def test_a_document_cut_off_by_a_syntax_error_is_not_blamed_for_what_was_not_reached():
    (message,) = faults("format: test/1\nlight: {kind: lamp, watts: 3\nlegs: {}\n")
    assert "not valid YAML" in message


def test_a_file_that_is_not_there_is_a_folder_or_cannot_be_read_is_one_fault(tmp_path):
    def fault_of(path) -> str:
        (fault,) = faults_of(read_document, path, Table)
        return fault

    assert fault_of(tmp_path / "no.yaml").startswith(f"{tmp_path}/no.yaml: ")
    assert fault_of(tmp_path).startswith(f"{tmp_path}: this is a folder")
    os.mkfifo(tmp_path / "pipe")
    assert fault_of(tmp_path / "pipe").startswith(f"{tmp_path}/pipe: ")
    assert "cannot be read" in fault_of(tmp_path / "a\0b")
    assert "cannot be read" in fault_of(tmp_path / ("x" * 300))


def test_a_file_one_byte_too_large_is_refused_not_cut(tmp_path):
    large = tmp_path / "large.yaml"
    text = b"format: test/1\nlight: {kind: lamp, watts: 1}\n#"
    large.write_bytes(text.ljust(MOST_BYTES, b"x"))
    assert read_document(large, Table).value.light.watts == 1
    large.write_bytes(text.ljust(MOST_BYTES + 1, b"x"))
    with pytest.raises(DocumentFaults, match="larger than 1000000 bytes"):
        read_document(large, Table)


def test_a_file_without_permission_is_one_fault(tmp_path, monkeypatch):
    secret = tmp_path / "secret.yaml"
    secret.write_text("a: 1\n")

    def refuse(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)  # root may read everything, so a mode would not do
    with pytest.raises(DocumentFaults, match=r"secret.yaml: no permission"):
        read_document(secret, Table)


def test_a_bare_name_finds_what_is_shipped_and_a_path_what_it_names(tmp_path, monkeypatch):
    (tmp_path / "shipped").mkdir()
    (tmp_path / "shipped" / "three.yaml").touch()
    monkeypatch.chdir(tmp_path)
    assert find_document("three", tmp_path / "shipped") == tmp_path / "shipped" / "three.yaml"
    assert find_document("shipped/three", tmp_path / "shipped") == Path("shipped/three")
    assert find_document("three.yaml", tmp_path / "shipped") == Path("three.yaml")
    with pytest.raises(DocumentFaults, match=r"'three'"):
        find_document("tree", tmp_path / "shipped")
    (tmp_path / "three").touch()
    assert find_document("three", tmp_path / "shipped") == Path("three")
