"""Printed form of numbers, times and other values: rounded according to their uncertainty.

U has two significant digits and is rounded up, unless rounding down takes 1 % or less; its value ends at the same
digit (JCGM 100, 7.2.6; ILAC-P14; EA-4/02). No markup.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from bench.records.events import UntilDecided
    from bench.records.results import CheckData, ConformityData, Results, StatementData
    from calib.studies.camera_check import OneViewCheck

_GOALS = {"expanded_fx_px": "U(fx)", "worst_corner_px": "U at the corners"}


def meaning_of_goal(name: str) -> str:
    """Return the goal ``expanded_fx_px`` or ``worst_corner_px`` as people read it."""
    return _GOALS.get(name, name)


def goals_text(wanted: Mapping[str, float]) -> str:
    """Return goals, the largest expanded uncertainties allowed, px, by name, as text.

    >>> goals_text({"expanded_fx_px": 2.0, "worst_corner_px": 0.3})
    'U(fx) is at most 2 px and U at the corners at most 0.3 px'
    """
    parts = [f"{meaning_of_goal(name)} at most {goal:g} px" for name, goal in wanted.items()]
    return " and ".join(parts).replace(" at most", " is at most", 1)


def beside_goal(value: float, goal: float, digits: int = 3) -> str:
    """Return a value with so many digits, and with more if only these show on which side of its goal it lies.

    >>> beside_goal(3.1416, 1.45), beside_goal(1.4523, 1.45), beside_goal(1.4499, 1.45)
    ('3.14', '1.452', '1.4499')
    """
    return f"{value:.{digits_beside(value, goal, digits)}g}"


def digits_beside(value: float, goal: float, digits: int = 3) -> int:
    """Return how many digits, at least ``digits``, show on which side of its goal a value lies."""
    side = value > goal, value < goal
    enough = range(digits, 18)  # 17 digits are the number itself
    return next(n for n in enough if ((shown := float(f"{value:.{n}g}")) > goal, shown < goal) == side)


def missed_text(now: Mapping[str, float], wanted: Mapping[str, float]) -> str:
    """Return each goal that is not met, px, with what is reached; empty if all are met.

    >>> missed_text({"expanded_fx_px": 1.4523}, {"expanded_fx_px": 1.45, "worst_corner_px": 0.3})
    'U(fx) is 1.452 px; the goal is 1.45 px. U at the corners is not known; the goal is 0.3 px.'
    """
    reached = {name: f"{beside_goal(now[name], goal)} px" for name, goal in wanted.items() if name in now}
    return " ".join(
        f"{meaning_of_goal(name)} is {reached.get(name, 'not known')}; the goal is {goal:g} px."
        for name, goal in wanted.items()
        if name not in now or now[name] > goal
    )


def goals_missed(decisions: Sequence[UntilDecided]) -> list[str]:
    """Return a sentence or more for each ``until`` that ended without its goals."""
    return [
        f"The goal of a step was not met. {decided.get('why', '')}".strip()
        for decided in decisions
        if decided.get("ended", "met") != "met"
    ]


def reached_text(decided: UntilDecided) -> str:
    """Return what an ``until_decided`` has reached, as ``4 poses (k = 2.2): U(fx) 3.1 px (wanted 2).``."""
    now = decided["now"]
    if not now:
        return f"{_poses_of(decided)}: no calibration yet. {decided.get('problem', '')}".strip()
    parts = [
        f"{meaning_of_goal(name)} {beside_goal(now[name], goal)} px (wanted {goal:g})"
        for name, goal in decided["wanted"].items()
    ]
    return f"{_poses_of(decided)}: {', '.join(parts)}."


def decision_text(decided: UntilDecided) -> str:
    """Return a journal line ``until_decided`` as one line of text."""
    if decided.get("ended", "met") != "met":
        return f"{_poses_of(decided)}: {decided.get('why', '')}"
    chosen = decided.get("chosen")
    if chosen is None:
        return f"{reached_text(decided)} {decided.get('why', '')}".strip()
    angles = ", ".join(f"{axis} {angle:g}" for axis, angle in chosen["angles_deg"].items())
    return f"{reached_text(decided)} Next: pose {chosen['pose']} at {angles} deg."


def _poses_of(decided: UntilDecided) -> str:
    """Return the number of poses in a calibration, with its coverage factor if there is one."""
    k = decided.get("coverage_factor")
    factor = f" (k = {k:.3g})" if decided["now"] and k else ""
    return f"{decided['poses']} pose{'' if decided['poses'] == 1 else 's'}{factor}"


_BOARD_WORDS = {
    "star": "point",
    "stars": "points",
    "Star": "Point",
    "Stars": "Points",
    "reticle": "board",
    "target": "board",
    "target's": "board's",
}
_WORD = re.compile(r"\b(?:target's|[Ss]tars?|reticle|target)\b")


class TargetWords(NamedTuple):
    """The words for one kind of target."""

    point: str
    points: str
    target: str

    @property
    def capital(self) -> str:
        """``points`` at the begin of a sentence."""
        return self.points.capitalize()

    @property
    def is_board(self) -> bool:
        """Whether they are words for a board."""
        return self == BOARD

    def fitting(self, text: str) -> str:
        """Return a sentence of this program, never a person's, which speaks of stars, in these words.

        >>> BOARD.fitting("as a bow of the reticle: the star noise, the stars' edges")
        "as a bow of the board: the point noise, the points' edges"
        """
        return _WORD.sub(lambda found: _BOARD_WORDS[found[0]], text) if self.is_board else text


STARS = TargetWords("star", "stars", "target")
BOARD = TargetWords("point", "points", "board")


def words_for(board: object) -> TargetWords:
    """Return the words for a board at finite distance or its description; without one, for the star target."""
    return BOARD if board else STARS


def words_of(results: Results) -> TargetWords:
    """Return the words for what a run recorded: those of a board if ``run`` names one."""
    return words_for((results.get("run") or {}).get("board"))


NOTHING = "\N{EN DASH}"
"""Printed in place of a missing value."""
MINUS = "\N{MINUS SIGN}"
_MILLI_FROM_URAD = 1000.0
_ARCSEC_PER_TENTH_DEGREE = 360.0

_UNITS = {"fx": "px", "fy": "px", "cx": "px", "cy": "px", "skew": "px", "x": "mm", "y": "mm", "r": "mm"}
_MEANINGS = {
    "fx": "focal length, along rows",
    "fy": "focal length, along columns",
    "cx": "principal point, column",
    "cy": "principal point, row",
    "k1": "radial distortion, 2nd order",
    "k2": "radial distortion, 4th order",
    "k3": "radial distortion, 6th order",
    "k4": "radial distortion, denominator, 2nd order",
    "k5": "radial distortion, denominator, 4th order",
    "k6": "radial distortion, denominator, 6th order",
    "p1": "tangential distortion",
    "p2": "tangential distortion",
    "skew": "skew of the pixels' axes, K[0, 1]",
    "x": "collimator axis on the target, X",
    "y": "collimator axis on the target, Y",
    "r": "collimator focal length, in the target's scale",
    "pupil_shift": "collimator: reticle out of focus",
    "radial": "collimator: distortion, or a curved reticle",
    "radial_4": "collimator: distortion, 4th order",
    "field_curve": "collimator: field curvature",
    "tilt_x": "collimator: reticle tilted, about Y",
    "tilt_y": "collimator: reticle tilted, about X",
    "coma": "collimator: coma",
    "coma_round": "collimator: coma, in all directions",
    "astigmatism": "collimator: astigmatism",
    "rim_4": "collimator: rim of the beam, 4th order",
    "rim_10": "collimator: rim of the beam, 10th order",
}


def known_parameters() -> tuple[str, ...]:
    """Return the names of all parameters that have a meaning in words."""
    return tuple(_MEANINGS)


def unit_of(parameter: str) -> str:
    """Return the unit of a parameter: ``px``, ``mm``, or ``1`` for a pure number such as a distortion coefficient."""
    return _UNITS.get(parameter, "1")


def unit_text(name: str) -> str:
    """Return the unit of a parameter, as it is printed after a number; empty for none."""
    unit = unit_of(name)
    return "" if unit == "1" else unit


def meaning_of(parameter: str) -> str:
    """Return a short description of a parameter; empty for an unknown one."""
    return _MEANINGS.get(parameter, "")


_DIGITS = 2
_NEGLIGIBLE = Decimal("0.01")
"""Largest share of U by which rounding down is allowed."""


def round_expanded(expanded: float) -> Decimal:
    """Round an expanded uncertainty above zero to two significant digits, up unless the difference is negligible.

    Its exponent is that of its last digit.

    >>> [str(round_expanded(one)) for one in (2.4106, 2.451, 0.0164, 9.99, 105.0, 0.000123)]
    ['2.4', '2.5', '0.017', '10', '1.1E+2', '0.00013']
    """
    exact = Decimal(repr(float(expanded)))
    if not exact.is_finite() or exact <= 0:
        raise ValueError(expanded)
    last = Decimal(1).scaleb(exact.adjusted() - _DIGITS + 1)
    down = exact.quantize(last, ROUND_HALF_EVEN)
    rounded = down if down >= exact * (1 - _NEGLIGIBLE) else exact.quantize(last, ROUND_CEILING)
    # 9.99 becomes 10.0, which has three digits
    return rounded if rounded.adjusted() == exact.adjusted() else rounded.quantize(last.scaleb(1))


def with_uncertainty(value: float, expanded: float) -> tuple[str, str]:
    """Print a value and its expanded uncertainty, U by `round_expanded`, the value to the same digit.

    If U is not a positive finite number, the value has six significant digits and U is a dash.

    >>> with_uncertainty(3345.0637, 1.2345)
    ('3345.1', '1.3')
    >>> with_uncertainty(-0.89731, 0.0996)
    ('−0.90', '0.10')
    >>> with_uncertainty(3345.06, 123.4)
    ('3350', '130')
    """
    if not (math.isfinite(value) and math.isfinite(expanded) and expanded > 0):
        return number(value, 6), NOTHING
    rounded = round_expanded(expanded)
    digit = int(rounded.as_tuple().exponent)
    return _plain(_to_digit(Decimal(repr(float(value))), digit)), _plain(rounded)


def number(value: Any, digits: int = 4) -> str:
    """Print a number with significant digits, without exponent; integers in full, None and infinities as a dash.

    The minus sign is true; narrow spaces stand between thousands of an integer.

    >>> number(0.0812345), number(345), number(-3.0), number(None), number(0.0)
    ('0.08123', '345', '−3.000', '–', '0')
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return NOTHING
    if isinstance(value, int):
        grouped = f"{abs(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
        return f"{MINUS if value < 0 else ''}{grouped}"
    if value == 0:
        return "0"
    exact = Decimal(repr(float(value)))
    return _plain(_to_digit(exact, exact.adjusted() - digits + 1))


def exact(value: float) -> str:
    """Print a number that is known exactly, in its shortest form, with nine significant digits at most.

    >>> exact(3345.06), exact(-0.9), exact(255.0)
    ('3345.06', '−0.9', '255')
    """
    return f"{value:.9g}".replace("-", MINUS)


def fixed(value: Any, decimals: int) -> str:
    """Print a number with a fixed number of decimals, never "minus zero"; None and infinities as a dash.

    >>> fixed(-0.0004, 3), fixed(1.23456, 3), fixed(None, 3)
    ('0.000', '1.235', '–')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    rounded = round(float(value), decimals) + 0.0
    return f"{rounded:.{decimals}f}".replace("-", MINUS)


def angle(arcsec: float) -> str:
    """Print an angle with three significant digits: degrees from 0.1 degrees on, arc seconds below.

    >>> angle(1.83), angle(359.0), angle(360.0), angle(20900.0)
    ('1.83″', '359″', '0.100°', '5.81°')
    """
    if arcsec >= _ARCSEC_PER_TENTH_DEGREE:
        return f"{number(arcsec / 3600, 3)}\N{DEGREE SIGN}"
    return f"{number(arcsec, 3)}\N{DOUBLE PRIME}"


def angle_text(urad: float) -> str:
    """Print a small angle with two significant digits, in µrad, or in mrad from 1000 µrad on.

    >>> angle_text(0.0), angle_text(23.44), angle_text(994.0), angle_text(996.0), angle_text(5123.0)
    ('0 µrad', '23 µrad', '990 µrad', '1.0 mrad', '5.1 mrad')
    """
    # Rounded first: 999.6 µrad is 1.0 mrad.
    rounded = float(f"{urad:.2g}")
    if rounded >= _MILLI_FROM_URAD:
        return f"{number(rounded / 1000.0, 2)} mrad"
    return f"{number(urad, 2)} \N{MICRO SIGN}rad"


def moment(text: str | None) -> str:
    """Print an ISO 8601 time in UTC, to the second; a dash for None and for an empty text.

    >>> moment("2026-03-01T12:00:05.123456Z")
    '2026-03-01 12:00:05 UTC'
    """
    if not text:
        return NOTHING
    return f"{datetime.fromisoformat(text):%Y-%m-%d %H:%M:%S} UTC"


def duration(seconds: float) -> str:
    """Print a duration in ms, s, min or h, as suits its length.

    >>> duration(0.0331), duration(12.34), duration(754), duration(7300)
    ('33 ms', '12.3 s', '12 min 34 s', '2 h 01 min')
    """
    if seconds < 1:
        return f"{seconds * 1000:.0f} ms"
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds < 3600:
        return f"{int(seconds // 60)} min {int(seconds % 60):02d} s"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60):02d} min"


def value_text(value: Any) -> str:
    """Print any value of results.json in one line; a dash for None and for empty values.

    >>> value_text({"bias_fo": 0, "afk": False}), value_text([1, 2.5]), value_text(None)
    ('bias_fo 0, afk off', '1, 2.500', '–')
    """
    if value is None or value in ("", {}, []):
        return NOTHING
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {value_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(value_text(item) for item in value)
    return str(value)


def _to_digit(value: Decimal, digit: int) -> Decimal:
    """Round to the decimal digit 10**digit, half to even."""
    return value.quantize(Decimal(1).scaleb(digit), rounding=ROUND_HALF_EVEN)


def _plain(value: Decimal) -> str:
    """Print without exponent, with a true minus sign and no minus zero."""
    text = f"{value:f}"
    return text.removeprefix("-") if not value else text.replace("-", MINUS)


_KEPT = {
    "pass": "inside by U or more",
    "conditionalPass": "inside, but by less than U: not proven",
    "conditionalFail": "outside, by U or less",
    "fail": "outside by more than U",
}


def conformity_headline(found: ConformityData) -> str:
    """Return PASS or FAIL, and how many limits are kept.

    >>> conformity_headline({"passed": True, "rule": "", "statements": [], "reasons": []})
    'PASS: the checked calibration is right.'
    """
    if not found["statements"]:  # a check alone
        return (
            "PASS: the checked calibration is right."
            if found["passed"]
            else "FAIL: the checked calibration is not right, or a gate failed."
        )
    kept = sum(one["verdict"] == "pass" for one in found["statements"])
    return f"{'PASS' if found['passed'] else 'FAIL'}: {kept} of {len(found['statements'])} limits kept."


def conformity_sentences(found: ConformityData) -> list[str]:
    """Return a sentence for each limit, those that are not kept first, then the other reasons and the decision rule."""
    ordered = sorted(found["statements"], key=lambda one: one["verdict"] == "pass")
    rule = [f"Decision rule: {found['rule']}."] if ordered else []
    return [*map(_statement_text, ordered), *found["reasons"], *rule]


def _statement_text(one: StatementData) -> str:
    name, unit = one["result"], unit_text(one["result"])
    bounds = [("at least", one["lower"]), ("at most", one["upper"])]
    limits = " and ".join(f"{word} {exact(bound)}" for word, bound in bounds if bound is not None)
    asked = (
        f"{limits}{' ' if unit else ''}{unit}{' by ' if one['specification'] else ''}{one['specification']}"
    )
    if one["value"] is None or one["expanded"] is None:
        return f"{name}: this calibration did not estimate it (limit: {asked})."
    value, expanded = with_uncertainty(one["value"], one["expanded"])
    return f"{name} {value} ± {expanded}{' ' if unit else ''}{unit} ({asked}): {_KEPT[one['verdict']]}."


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


def one_view_sentences(check: OneViewCheck, *, board: bool) -> Iterator[str]:
    """Yield what one view at an unknown place tells, and which changes it can see."""
    whose = "of a board" if board else "without a known collimator"
    yield f"One view {whose}: judged is only what no other pose explains."
    off = (
        f"after the best pose the image still differs by {check.rms_px:.2f} px RMS, most at"
        f" ({check.at_px[0]:.0f}, {check.at_px[1]:.0f}): {check.largest_px:.2f} px (E_n {check.normalised:.2f})."
    )
    if check.right:
        yield f"RIGHT as far as this view can tell (E_n {check.normalised:.2f}, {check.points} points)."
    elif board:
        yield f"NOT RIGHT: {off}"
    else:
        yield f"UNDECIDED: {off} The lens changed, or the collimator distorts: a passport of it would decide."
    seen = [_seen_text(name, size) for name, size in check.seen_from.items()]
    yield f"A change of one value alone would be seen from: {', '.join(seen)}."


def _seen_text(name: str, size: float) -> str:
    if not math.isfinite(size):
        return f"{name} never"
    if name == "scale":
        return f"scale {100.0 * size:.2g} %"
    return f"{name} {size:.2g}{' px' if name in ('cx', 'cy') else ''}"
