"""Templates of described devices: read in one way only, bounded, and refused with what to write instead."""

import time
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.described.description import TemplateFault, parse_template, with_checksum
from drivers.errors import OutsideLimits

NONE: frozenset[str] = frozenset()


def reply(text: str):
    return parse_template(text, known=frozenset({"request"}), readable=None)


@pytest.mark.parametrize(
    ("template", "line", "values"),
    [
        ("POS={counts:integer}", "POS=-12", {"counts": -12.0}),
        ("POS={counts:integer}", "POS=-12 ", None),
        ("POS={counts:integer}", "POS=1.5", None),
        # Sigma-Koki SHOT-302GS, command Q: a sign, and blanks before the digits
        ("{a:integer},{b:integer},K,K,R", "-      2000,       150,K,K,R", {"a": -2000.0, "b": 150.0}),
        ("POS={counts:integer}", "POS=1 000", None),
        ("{x:number}", "  1.5", {"x": 1.5}),
        ("{request} * {counts:number}", "PP * 1.5e3", {"counts": 1500.0}),
        ("{request} * {counts:number}", "PD * 15", None),
        ("{request} = {a:word},{b:text}", "PP = on,all is well", {"a": "on", "b": "all is well"}),
        ("{request} *", "PP *", {}),
        ("STATE {state:word} {x:number}", "STATE   IDLE    1.5", {"state": "IDLE", "x": 1.5}),
        ("a  b", "a b", {}),
        ("a b", "ab", None),
        ("{x:number}", "nan", None),
        # Thorlabs ELLx modules: positions are signed, 8 digits; Newport SMC100, TS: 4 digits and 2 letters or digits
        ("0PO{x:signed_hex.8}", "0POFFFFF072", {"x": -3982.0}),
        ("0PO{x:signed_hex.8}", "0PO0000f072", {"x": 61554.0}),
        ("0PO{x:signed_hex.8}", "0PO00F072", None),
        ("1TS{errors:hex.4}{state:word}", "1TS80210A", {"errors": 32801.0, "state": "0A"}),
        # OWIS PS 90, ?ASTAT: a letter for each axis
        ("{state_1:word.1}{state_2:word.1}{rest:word}", "RTI", {"state_1": "R", "state_2": "T", "rest": "I"}),
        ("{state_1:word.1}{state_2:word.1}", "R", None),
        ("{state:word.2}", "RTI", None),
        ("{x:sign}P{x:size}", "-P400", {"x": -400.0}),
        ("{x:sign}P{x:size}", "P400", None),
        ("{x:number}", "1e999", None),
    ],
)
def test_a_line_is_read_or_refused(template, line, values) -> None:
    assert reply(template).match(line, {"request": "PP"}) == values


@pytest.mark.parametrize(
    ("template", "fault"),
    [
        ("{counts}", "needs a kind"),
        ("{counts:real}", "is no kind"),
        ("{counts:integer}{state:word}", "text must stand between"),
        ("{counts:integer}00", "the end of {counts} is not clear"),
        ("{all:text}!", "nothing may follow"),
        ("{counts:integer} {counts:integer}", "stands twice"),
        ("{counts:integer", "no partner"),
        ("{Counts:integer}", "is no placeholder"),
        ("{counts:text.2}", "decimals are written"),
        ("{counts:number.12}", "at most 9"),
        ("{counts:hex}", "digits are written {counts:hex.8}"),
        ("{counts:hex.9}", "at most 8"),
        ("{counts:sign}{state:size}", "needs {counts:size} behind it"),
        ("\t", "printable ASCII"),
        ("x" * 201, "200 or fewer"),
        ("{__class__:text}", "is no placeholder"),
    ],
)
def test_a_template_that_could_be_read_in_two_ways_is_refused(template, fault) -> None:
    with pytest.raises(TemplateFault, match=fault):
        reply(template)


def test_a_request_takes_known_values_only() -> None:
    template = parse_template(
        "{address}P{target:integer}", known=frozenset({"address"}), readable=frozenset({"target"})
    )
    assert template.render({"address": "P", "target": -1000.4}) == "PP-1000"
    with pytest.raises(TemplateFault, match="no value 'goal' here"):
        parse_template("{goal:integer}", known=NONE, readable=frozenset({"target"}))


@pytest.mark.parametrize(
    ("request_", "value", "text"),
    [
        ("{v:hex.2}", 200.4, "C8"),
        ("{v:integer.5}", -7, "-0007"),
        ("{v:signed_hex.4}", -2, "FFFE"),
        ("A:{v:sign}P{v:size}", -0.4, "A:+P0"),
        (":w21={v:word}.", 50.0, ":w21=50."),  # JDS6600: no reply could end so; a word may hold a full stop
    ],
)
def test_numbers_are_sent_in_the_devices_own_digits(request_, value, text) -> None:
    assert parse_template(request_, known=NONE, readable=frozenset({"v"})).render({"v": value}) == text


@pytest.mark.parametrize(
    ("request_", "value", "sent"),
    [
        ("{v:integer}0", 12.4, 12.0),
        ("{v:number.1}.", -0.26, -0.3),
        ("{v:sign}P{v:size}", -400.4, -400.0),
        ("{v:signed_hex.4}", -2.2, -2.0),
        ("{v:word}.", 50.0, 50.0),
        ("ABSOL1", 1.0, 1.0),
    ],
)
def test_a_value_is_known_as_it_is_sent(request_, value, sent) -> None:
    assert parse_template(request_, known=NONE, readable=frozenset({"v"})).as_sent({"v": value}, "v") == sent


@pytest.mark.parametrize(
    ("kind", "body", "digits"),
    [
        ("none", b"VOLT=5", b""),
        ("xor", b"GPGLL,5300.97914,N,00259.98174,E,125926,A", b"*28"),  # a sentence of NMEA 0183
        ("sum", b"123", b"96"),
        ("complement", b"1 1 03 home", b"32"),  # as zaber-motion sends it
    ],
)
def test_a_checksum_is_one_of_a_few_kinds(kind, body, digits) -> None:
    assert with_checksum(kind, body) == body + digits


@pytest.mark.parametrize(("kind", "value"), [("hex.2", 256), ("hex.2", -1), ("signed_hex.2", 128)])
def test_a_number_that_does_not_fit_into_its_digits_is_not_sent(kind, value) -> None:
    with pytest.raises(OutsideLimits, match="2 hexadecimal digits"):
        parse_template(f"{{v:{kind}}}", known=NONE, readable=frozenset({"v"})).render({"v": value})


def test_no_line_takes_long_to_refuse() -> None:
    template = reply("{a:number} {b:number} {c:number} {d:number}x")
    began_s = time.perf_counter()
    for line in ("1" * 4096, "1 " * 2048, "1e" * 2048, "." * 4096, "1.1.1.1" * 500):
        assert template.match(line, {}) is None
    assert time.perf_counter() - began_s < 0.1


@given(st.floats(-1e9, 1e9), st.integers(0, 9))
def test_what_is_sent_reads_back_as_it_was_sent(value, decimals) -> None:
    template = parse_template(f"SET {{value:number.{decimals}}}", known=NONE, readable=frozenset({"value"}))
    read = template.match(template.render({"value": value}), {})
    assert read is not None
    assert read["value"] == pytest.approx(value, abs=0.51 * 10.0**-decimals, rel=1e-12)


@given(st.text(max_size=60))
def test_any_text_is_a_template_or_a_fault(text) -> None:
    with suppress(TemplateFault):
        assert reply(text).match("", {"request": "x"}) in (None, {})
