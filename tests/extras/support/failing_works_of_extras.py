"""Works of the extras that write, each of which goes on whichever of its calls to the disk fails or kills."""

import os
from unittest import mock

from certificate_lab import FIRST, Lab, quick_files
from failing_calls import tried
from failing_works import SIZE_OPTION, main_of, new, once, patches
from many_runs import write_run
from sealed_bench import write_sealed_run

from bench.base.errors import UsageError
from bench.commands.cli import main
from bench.extras.certificate.series import numbers
from bench.record.storage import sha256_of

BOARD = "--board checkerboard:11x7:20mm"
COMMANDS = {
    **{f"convert {kind}": f"convert {{in}}/a.npz {{out}} --as {kind}"
       for kind in ("raw", "metavision", "hdf5", "parquet", "csv")},
    "convert numpy": "convert {in}/a.h5 {out} --as numpy",
    "certificate new": "certificate new {out}",
    "certificate timestamp --request": "certificate timestamp {in}/sealed --request {out}",
    "undistort": "undistort {in}/left.yaml -o {out}",
    "rig": f"rig {{in}}/left {{in}}/right {BOARD} {SIZE_OPTION} -o {{out}}",
    "history table": "history table {in}/runs -o {out}.csv",
}  # fmt: skip
GOING_ON = {"convert many": "convert {in}/a.npz {in}/b.npz {out} --as csv --workers 1"}


class Issue:
    """A certificate, issued by the same command with the same number."""

    name = "certificate"

    def prepare(self, folder):
        return Lab(new(folder))

    def do(self, lab):
        lab.issue()

    def check(self, lab, end):
        if end.status and lab.numbers() != {FIRST: "issued"}:
            lab.issue()
        elif end.status:  # the line is there, its sync had failed
            try:
                lab.issue()
            except UsageError as told:
                assert f"This folder is the certificate {FIRST}, which is issued" in str(told)  # noqa: PT017
        assert lab.numbers() == {FIRST: "issued"}
        (certificate,) = numbers(lab.ledger.entries()).values()
        assert certificate.seal == sha256_of(lab.path / "certificate" / "SHA256SUMS")
        assert lab.ledger.breaks() == ([], [])


OTHERS = {"certificate": Issue}


def prepare(inputs):
    """Write what these commands read besides: events in HDF5, a sealed run, and runs."""
    tried(lambda: main(["convert", str(inputs / "a.npz"), str(inputs / "a.h5")]), inputs)
    os.link(inputs / "a.npz", inputs / "b.npz")
    write_sealed_run(inputs / "sealed", inputs / "home")
    for name in "ab":
        write_run(inputs / "runs" / name)


if __name__ == "__main__":
    quick = [
        once("bench.extras.tools.rig_of_views", "find_rig"),
        mock.patch("bench.extras.certificate.issue.certificate_files", quick_files),
        mock.patch("bench.extras.certificate.pdf.plots_of_run", return_value={}),
    ]
    main_of(COMMANDS, GOING_ON, OTHERS, [*patches(), *quick], prepare)
