"""How long a night takes that is rehearsed: sixty runs of nine poses on a virtual clock, summary included."""

from __future__ import annotations

import tempfile
import time
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

from bench.batch.batch_plan import read_queue
from bench.batch.rehearsed_night import rehearse_batch

QUEUE = Path(__file__).parents[2] / "sequences" / "night" / "queue.yaml"
BEGIN = datetime(2026, 3, 1, 19, 30, tzinfo=ZoneInfo("Europe/Berlin"))


def main() -> None:
    """Rehearse it, and print how much faster than the night itself that was."""
    queue = read_queue(QUEUE)
    with tempfile.TemporaryDirectory(prefix=".bench-night-", dir=".") as place:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        summary = rehearse_batch(queue, Path(place) / "night", begin=BEGIN, seed=1, say=lambda _: None)
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    totals = summary["totals"]
    print(
        f"{totals['runs']} runs, {totals['recordings']} recordings, {totals['hours']:.1f} h:"
        f" {wall_s:.0f} s, of which {cpu_s:.1f} s computing; {3600 * totals['hours'] / wall_s:.0f} times faster"
    )


if __name__ == "__main__":
    main()
