"""The recording that `bench.measure.warm_up` draws to compile the loops that find stars."""

from bench.measure.warm_up import measure_drawing


def test_the_drawn_recording_is_measured_to_the_end():
    assert measure_drawing().stars > 200
