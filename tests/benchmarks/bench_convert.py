"""Speed of `convert`, in events per CPU second, and the sizes of what it makes.

    python tests/benchmarks/bench_convert.py [--repeated FILE] [--events 20] [--rounds 3] [--write]

Three recordings as an IMX636 sends them, of so many million events: sparse (single events, the clock dominates), flicker
(about 1.8 bytes an event, as in the published comparisons) and dense (vectors nearly full). A recording of a real camera
is repeated to a gigabyte, with the clock going on. Each is converted once without a clock, and then some times with it.
"""

import tempfile
import time
from pathlib import Path

import measured
import numpy as np

from drivers.camera.formats.event_conversion import convert
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer

KINDS = {"hdf5": "plain HDF5", "metavision": "Metavision's HDF5", "parquet": "Parquet"}
HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n"
SCENES = {"sparse": (0.0008, 1.0), "flicker": (0.12, 16.0), "dense": (0.6, 60.0)}
"""Share of a row's pixels that fire in one read, and events a microsecond."""
LARGE_BYTES = 1_000_000_000
_TIME_HIGH = 0x8
"""Type of the words of EVT3 with the upper 12 of 24 bits of the clock."""


def write_scene(path: Path, least_events: int, density: float, rate_mev_s: float) -> None:
    """Write a recording of rows read one after the other, each with randomly placed events."""
    rng = np.random.default_rng(7)
    rows_at_once = 2000
    writer = Evt3Writer()
    begin, written = 0.0, 0
    with path.open("wb") as file:
        file.write(HEADER)
        while written < least_events:
            fired = rng.random((rows_at_once, 1280)) < density
            read, x = np.nonzero(fired)
            gap_us = max(1280 * density, 1.0) / rate_mev_s
            t = np.floor(begin + read * gap_us).astype(np.int64)
            begin += rows_at_once * gap_us
            y, p = (read * 7 % 720).astype(np.uint16), (read // 360 % 2).astype(np.uint8)
            words = writer.write(t, x.astype(np.uint16), y, p, until_us=int(np.floor(begin)))
            file.write(words.tobytes())
            written += len(t)


def write_repeated(path: Path, source: Path) -> None:
    """Write a recording of EVT3 again and again, up to a gigabyte; the clock goes on by whole steps of its upper part."""
    header_bytes = RawFile.open(source).raw_header.size_bytes
    words = np.fromfile(source, "<u2", offset=header_bytes)
    places = np.flatnonzero(words >> 12 == _TIME_HIGH)
    upper = words[places].astype(np.int64) % 4096
    steps = (int(upper[-1]) - int(upper[0])) % 4096 + 1
    with path.open("wb") as file:
        file.write(source.read_bytes()[:header_bytes])
        for number in range(-(-LARGE_BYTES // words.nbytes)):
            words[places] = _TIME_HIGH << 12 | (upper + number * steps) % 4096
            file.write(words.tobytes())


def cell_of(source: Path, kind: str, rounds: int, folder: Path) -> str:
    """Convert a file; return millions of events per CPU second, and bytes an event."""
    target, times_s = folder / "made", []
    for number in range(rounds + 1):
        begun = time.process_time()
        events = convert(source, target, kind).events
        if number:
            times_s.append(time.process_time() - begun)
        size = target.stat().st_size
        target.unlink()
    return f"{events / 1e6 / measured.spread(times_s).median_s:.0f}; {size / events:.2f}"


def main() -> None:
    """Print a table: a row for each format, a column for each recording."""
    parser = measured.options(__doc__)
    parser.add_argument("--repeated", type=Path, help="a RAW file of a real camera, repeated to a gigabyte")
    parser.add_argument("--events", type=float, default=20.0, help="millions of each drawn recording")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = {scene: folder / f"{scene}.raw" for scene in SCENES}
        for scene, path in paths.items():
            write_scene(path, int(1e6 * options.events), *SCENES[scene])
        if options.repeated:
            paths["real, 1 GB"] = folder / "repeated.raw"
            write_repeated(paths["real, 1 GB"], options.repeated)
        print(f"| Mev per CPU s; bytes an event | {' | '.join(paths)} |\n|{' --- |' * (1 + len(paths))}")
        for kind, shown in KINDS.items():
            cells = [cell_of(path, kind, options.rounds, folder) for path in paths.values()]
            print(f"| {shown} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    measured.run(main, "costs", "Converting a recording")
