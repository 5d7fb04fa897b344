"""What a run departs from before it begins: values of its files that were replaced, and gates looser than usual."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from bench.measure.gates import looser_gates
from bench.plan.job import Job
from sequences.script import RecordStep

_MOST_CHARACTERS = 200  # Two lines of a report


def departures(job: Job, settings: Mapping[str, str]) -> list[str]:
    """Return a sentence for each setting of the command line or the queue, and for each gate that was loosened."""
    texts = [f"{path} was set to {_short(text)} for this run." for path, text in settings.items()]
    return list(dict.fromkeys([*texts, *_loosened(job)]))


def _loosened(job: Job) -> Iterator[str]:
    for step in job.steps:
        light = job.light_before(step)
        if isinstance(step, RecordStep) and light is not None and light.flicker is not None:
            yield from looser_gates(step.gates, light.flicker.waveform)


def _short(text: str) -> str:
    plain = " ".join(text.split())
    return plain if len(plain) <= _MOST_CHARACTERS else f"{plain[:_MOST_CHARACTERS]}..."
