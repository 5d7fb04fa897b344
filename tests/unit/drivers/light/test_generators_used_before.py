"""Generators that somebody used before us: bursts, sweeps, modulations and a turned polarity do not survive into a run."""

import pytest

from drivers.errors import SettingRefused
from drivers.light import LightSettings
from drivers.light.scpi_dialects import DIALECTS
from tests.unit.drivers.light.generator_bench import Bench

OTHERS = pytest.mark.parametrize("dialect", ["keysight", "numbered", "siglent"])


def test_a_generator_without_such_modes_is_not_asked_for_them_again() -> None:
    bench = Bench()
    light = bench.open()
    light.apply(LightSettings(frequency_hz=60.0))
    assert "BURS:STAT OFF" in bench.sent()
    bench.line.sent.clear()
    light.apply(LightSettings(frequency_hz=50.0))
    assert "BURS:STAT OFF" not in bench.sent()


@OTHERS
def test_a_generator_without_a_polarity_of_sync_is_not_said_to_have_it(dialect) -> None:
    bench = Bench(dialect)
    bench.line.turn("OUTP1:SYNC:POL", "OUTP1:SYNC:POX")
    assert bench.open().sync_polarity().startswith("not stated")


def test_one_spoilt_reply_about_a_mode_is_asked_for_again_and_refuses_nothing() -> None:
    bench = Bench()
    light, left = bench.open(), [b"1\n"]
    bench.line.spoil = lambda reply: left.pop() if left and bench.sent()[-1] == "BURS:STAT?" else reply
    light.apply(LightSettings(frequency_hz=60.0))
    assert bench.sent().count("BURS:STAT?") == 2


def test_a_generator_that_is_silent_about_its_first_mode_is_asked_for_no_other() -> None:
    bench = Bench()
    queries = {mode.query for mode in DIALECTS["keysight"].modes()}
    bench.line.spoil = lambda reply: b"" if bench.sent()[-1] in queries else reply
    light = bench.open(load="unchanged")
    light.apply(LightSettings(frequency_hz=60.0))
    light.apply(LightSettings(frequency_hz=50.0))
    assert len({text for text in bench.sent() if text in queries}) == 1


SPOILT = [
    ("numbered", "OUTP1:SYNC:DEL", "4.000000E-03", "0"),  # Rigol DG1000Z and DG4000, up to one period
    ("numbered", "OUTP1:NOIS:STAT", "ON", "OFF"),  # Rigol DG4000
    ("siglent", "C1:INVT", "C1:INVT ON", "OFF"),  # beside PLRT
    ("siglent", "C1:NOISE_ADD", "C1:NOISE_ADD STATE,ON,RATIO,100,RATIO_DB,20dB", "STATE,OFF"),
]


@pytest.mark.parametrize(("dialect", "header", "answer", "undone"), SPOILT)
@pytest.mark.parametrize("stays", [False, True])
def test_what_shifts_inverts_or_blurs_the_signal_is_undone(dialect, header, answer, undone, stays) -> None:
    """Commands and answers: Rigol's programming guides; Siglent's "SDG Series Programming Guide"."""
    bench = Bench(dialect)
    receive, left = bench.line.device.receive, [True]

    def reply(data: bytes) -> bytes:
        if left[0] and data == f"{header} {undone}\n".encode():
            left[0] = stays
            return b""
        return f"{answer}\n".encode() if left[0] and data == f"{header}?\n".encode() else receive(data)

    bench.line.device.receive = reply
    light = bench.open()
    assert left == [True]  # opening sets nothing
    if stays:
        with pytest.raises(SettingRefused, match=f"after '{header} {undone}', '{header}\\?' is answered by"):
            light.apply(LightSettings(frequency_hz=60.0))
    else:
        light.apply(LightSettings(frequency_hz=60.0))
        assert left == [False]


LOADS = [
    ("keysight", "OUTP:LOAD", "+9.9E+37", "+5.00000000E+01"),  # 33220A User's Guide: 9.9E+37 or ohms
    ("numbered", "OUTP1:LOAD", "9.900000E+37", "5.000000E+01"),  # Rigol DG800 Programming Guide, :OUTPut:LOAD
    ("numbered", "OUTP1:LOAD", "INFINITY", "50"),  # Rigol DG4000, DG5000
    ("siglent", "C1:OUTP", "C1:OUTP OFF,LOAD,HZ,PLRT,NOR", "C1:OUTP OFF,LOAD,50,PLRT,NOR"),  # SDG Series
]


@pytest.mark.parametrize(("dialect", "header", "infinite", "fifty"), LOADS)
@pytest.mark.parametrize("load", ["high-z", "50-ohm"])
def test_a_load_that_is_not_taken_is_refused(dialect, header, infinite, fifty, load) -> None:
    for answer, is_taken in ((infinite, load == "high-z"), (fifty, load == "50-ohm")):
        bench = Bench(dialect)
        bench.answer({header: answer})
        light = bench.open(load=load)
        if is_taken:
            light.apply(LightSettings(frequency_hz=60.0))
        else:
            with pytest.raises(SettingRefused, match=r"load stays .*LOAD"):
                light.apply(LightSettings(frequency_hz=60.0))


def test_a_generator_that_does_not_tell_its_load_is_believed() -> None:
    bench = Bench()
    bench.line.turn("OUTP:LOAD\\?", "OUTP:LOAF?")
    assert bench.open().apply(LightSettings(frequency_hz=60.0)).frequency_hz == 60.0
