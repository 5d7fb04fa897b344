"""What a check of a calibration found, in words: for the command `check`, the report and the end of a run."""

from __future__ import annotations

from collections.abc import Iterator

from bench.records.results import CheckData

_CAUSES = {
    "scale": "A change of scale explains it: the focus or the temperature of the lens changed",
    "principal point": "A shift of the principal point explains it: the lens or the sensor moved in its mount",
    "lens": "A change of the distortion explains it: the lens, its focus or its aperture changed",
    None: "No single change explains it",
}


def check_sentences(check: CheckData) -> Iterator[str]:
    """Yield whether the calibration is right, where it is not, and the cause; or how large a change may be unseen."""
    worst = max(check["regions"], key=lambda one: one["normalised"])
    there = f"{worst['name']}, at ({worst['at_px'][0]:.0f}, {worst['at_px'][1]:.0f})"
    if check["right"]:
        unseen = max(one["expanded_px"] for one in check["regions"])
        yield f"RIGHT within U everywhere on the sensor: the largest E_n is {worst['normalised']:.2f} ({there})."
        yield f"A change of the image of less than {unseen:.2f} px can stay unseen by these views."
        return
    yield (
        f"NOT RIGHT: {there}, the image moved by {worst['offset_px']:.2f} px; U is {worst['expanded_px']:.2f} px"
        f" (E_n {worst['normalised']:.2f}). {_CAUSES[check['cause']]}."
    )
