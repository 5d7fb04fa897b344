"""The recording that `bench.warm_up` draws to compile the loops that measure stars."""

import bench.measure.measure
from bench.warm_up import compile_part


def test_the_drawn_recording_is_measured_to_the_end(monkeypatch):
    measured, real = [], bench.measure.measure.measure

    def measure(*args, **options):
        measured.append(real(*args, **options))

    monkeypatch.setattr(bench.measure.measure, "measure", measure)
    compile_part("stars")
    assert measured[0].stars > 200
