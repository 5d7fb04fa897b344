"""Measures slices in a process of its own, so that a stop and the page never wait for a measurement.

The engine's compiled loops hold Python's global lock for tens of milliseconds. The process ends when its input closes.
"""

from __future__ import annotations

from typing import Any, Final

from bench.base.errors import BenchError
from bench.base.worker_process import WorkerProcess, answer_questions
from bench.extras.pages.align.live_figures import LiveFigures, LiveMeter, LiveSetting, LiveSlice

_ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Small matrices gain nothing from more threads, and these take the cores from camera and page."""


class MeterProcess:
    """Measures in a process of its own, which is started again when it has ended."""

    def __init__(self) -> None:
        self._worker = WorkerProcess("bench.extras.pages.align.meter", _ONE_THREAD)
        self._worker.start()

    def measure(self, part: LiveSlice, setting: LiveSetting) -> tuple[bytes, LiveFigures]:
        """Measure a slice. Raises BenchError if it could not be measured; the next one may be."""
        try:
            answer: tuple[bytes, LiveFigures] | str = self._worker.ask((part, setting))
        except EOFError as error:
            raise BenchError(
                "The process that measures has ended by itself.",
                remedy="It is started again; wait some seconds.",
            ) from error
        if isinstance(answer, str):
            raise BenchError(
                f"The slice could not be measured: {answer}",
                remedy="The next one is tried. Report it if it stays.",
            )
        return answer

    def close(self) -> None:
        """End the measuring."""
        self._worker.close()


Meter = LiveMeter | MeterProcess


def main() -> None:
    """Measure for the process that has started this one."""
    meter = LiveMeter()

    def answer(question: Any) -> Any:
        try:
            return meter.measure(*question)
        except Exception as error:  # noqa: BLE001 - one bad slice must not end the measuring
            return f"{type(error).__name__}: {error}"

    answer_questions(answer)


if __name__ == "__main__":
    main()
