"""Certificates for tests: a full one with the numbers of a real simulated run, and a small one."""

import dataclasses
import functools
import json
from pathlib import Path

from bench.certificate.certificate_data import (
    Accreditation,
    Address,
    Amends,
    AuthorisedBy,
    BeforeAdjustment,
    Budget,
    BudgetRow,
    Camera,
    Certificate,
    Change,
    Condition,
    Conformity,
    Contact,
    Covariance,
    Customer,
    Deviation,
    FurtherResult,
    Item,
    Laboratory,
    Lens,
    Method,
    Result,
    Run,
    Software,
    Statement,
    Traceability,
    ValueBefore,
    sha256,
)

RESULTS = Path(__file__).with_name("certificate_results.json")
"""results.json of a sealed simulated run of three poses, without the truth."""
ISSUED = "2026-11-21T08:30:00Z"
NAMES = {
    "fx": ("focal length along x", "px"),
    "fy": ("focal length along y", "px"),
    "cx": ("principal point, x", "px"),
    "cy": ("principal point, y", "px"),
    "k1": ("radial distortion, second order", "1"),
    "k2": ("radial distortion, fourth order", "1"),
}
PRINTED = {
    "fx": ("3346.4", "2.5"),
    "fy": ("3346.4", "2.5"),
    "cx": ("642.5", "2.9"),
    "cy": ("363.4", "6.1"),
    "k1": ("0.049", "0.017"),
    "k2": ("-0.68", "0.36"),
}


@functools.cache
def sample_results():
    """The results that the full sample is made of."""
    return json.loads(RESULTS.read_bytes())


def _results(calibration):
    k = calibration["coverage_factor"]
    return tuple(
        Result(
            symbol=symbol,
            name=name,
            value=calibration["camera"][symbol],
            unit=unit,
            u=calibration["sigma"][symbol],
            U=float(PRINTED[symbol][1]),
            k=k,
            p=0.9545,
            nu_eff=12.48,
            printed_value=PRINTED[symbol][0],
            printed_uncertainty=PRINTED[symbol][1],
            text=f"{PRINTED[symbol][0]} {unit} \N{PLUS-MINUS SIGN} {PRINTED[symbol][1]} {unit}"
            if unit != "1"
            else f"{PRINTED[symbol][0]} \N{PLUS-MINUS SIGN} {PRINTED[symbol][1]}",
            customer_supplied=False,
        )
        for symbol, (name, unit) in NAMES.items()
    )


def _covariance(calibration):
    names, matrix = calibration["covariance"]["names"], calibration["covariance"]["matrix"]
    at = [names.index(symbol) for symbol in NAMES]
    return Covariance(
        tuple(NAMES),
        tuple(unit for _, unit in NAMES.values()),
        tuple(tuple(matrix[i][j] for j in at) for i in at),
    )


def _budget(calibration, symbol):
    """The rows of a result; those of the certificate and of the print carry a certificate number."""
    unit = NAMES[symbol][1]
    rows = []
    known = calibration["budget_rows"] if symbol in ("fx", "fy") else None
    for source, parts in calibration["budget"].items() if known is None else ():
        rows.append(
            BudgetRow(
                name=source,
                type="A" if source in ("stars", "disagreement of the views") else "B",
                value=None,
                unit="",
                distribution="normal",
                divisor=None,
                sensitivity=None,
                sensitivity_unit="",
                u=parts[symbol],
                share=(parts[symbol] / calibration["sigma"][symbol]) ** 2,
                nu=12.48 if source in ("stars", "disagreement of the views") else None,
                source="residuals of the stars",
                number="",
                date="",
                sha256="",
            )
        )
    for row in known or ():
        certificate = row["name"] == "passport of the collimator"
        rows.append(
            BudgetRow(
                name=row["name"],
                type=row["type"],
                value=row["value"],
                unit=row["unit"],
                distribution=row["distribution"],
                divisor=row["divisor"],
                sensitivity=row["sensitivity"].get(symbol),
                sensitivity_unit=f"px / ({row['unit']})" if row["sensitivity"] else "",
                u=row["contribution"][symbol],
                share=row["share"][symbol],
                nu=row["degrees_of_freedom"],
                source=row["source"],
                number="SIM-2026-01" if certificate else "",
                date="2026-01-12" if certificate else "",
                sha256="e328549503ebda4e41bac7e0be61ebd9acafde83372e242199aa90678c1d9d7b"
                if certificate
                else "",
            )
        )
    return Budget(
        symbol,
        unit,
        tuple(rows),
        u=calibration["sigma"][symbol],
        nu_eff=12.48,
        k=calibration["coverage_factor"],
        U=float(PRINTED[symbol][1]),
        remarks=("The sources overlap in the joint adjustment; each share is what the source alone adds.",),
    )


def _run(results, data):
    return Run(
        id=results["run"]["id"],
        sequence=results["run"]["sequence"],
        station=results["run"]["station"],
        ledger_number=results["run"]["ledger"]["number"],
        ledger_head=results["run"]["ledger"]["head"],
        journal_head="4f" * 32,
        seal_sha256="5e" * 32,
        results_sha256=sha256(data),
        signer="bench@lab",
        signer_fingerprint="SHA256:Sces8o9+LQPy9Z1snLqj6+sutjM38veePqEncDBU3Tc",
        software=tuple(Software(*pair) for pair in results["run"]["software"].items()),
    )


def _item(results):
    camera = results["devices"]["camera"]
    return Item(
        camera=Camera(
            maker=camera["maker"],
            model=camera["model"],
            sensor=camera["sensor"],
            serial=camera["serial"],
            firmware=camera["firmware"],
            image_size=(1280, 720),
            biases=(
                "bias_diff_off = 0",
                "bias_diff_on = 0",
                "bias_fo = 0",
                "bias_hpf = 0",
                "bias_refr = 0",
            ),
            biases_sha256="ab" * 32,
        ),
        lens=Lens(
            "Kowa", "LM16JC10M", "0042-17", "infinity", "f/2.8", focus_locked=True, aperture_locked=True
        ),
        customer_id="Inventory 2231 <b>&",
        condition="No visible damage; front lens clean.",
    )


STATEMENTS = (
    Statement(
        "simulated",
        "SIMULATED: the devices of this run were simulated. This is no certificate of a real camera.",
    ),
    Statement("items", "The results relate only to the item calibrated, in the condition described."),
    Statement(
        "reproduction",
        "This certificate shall not be reproduced except in full without approval of the laboratory.",
    ),
    Statement(
        "uncertainty",
        "The expanded uncertainty U is the standard uncertainty multiplied by the coverage factor k stated with each"
        " result, for a probability of coverage of about 95 %.",
    ),
    Statement(
        "model",
        "Image point: u = fx x' + cx, v = fy y' + cy, with x' = x (1 + k1 r^2 + k2 r^4), y' likewise.",
    ),
)


def full_certificate():
    """A certificate with everything in it, of the simulated run of `sample_results`."""
    results, data = sample_results(), RESULTS.read_bytes()
    calibration, projection = results["calibration"], results["projection"]
    return Certificate(
        format="starbench/certificate/1",
        language="en",
        title="SIMULATED calibration certificate",
        number="SIMULATED-SB-2026-00017",
        series="SB-{year}-{number:05d}",
        simulated=True,
        laboratory=Laboratory(
            "Optical Laboratory Ltd \N{EN DASH} Kalibrierlabor f\N{LATIN SMALL LETTER U WITH DIAERESIS}r Kameras",
            Address("Sternstra\N{LATIN SMALL LETTER SHARP S}e 5", "38116", "Braunschweig", "DE"),
            Contact("Calibration office", "office@lab.example", "+49 531 000000"),
            Accreditation("DAkkS", "D-K-00000-01-00", "Geometric calibration of cameras"),
            "laboratory",
            "Room 2.17, Sternstra\N{LATIN SMALL LETTER SHARP S}e 5, Braunschweig",
        ),
        customer=Customer(
            "Customer & Sons <GmbH>",
            Contact("Ada Byron", "ada@customer.example", ""),
            Address("Mill Lane 3", "CB2 1RX", "Cambridge", "GB"),
        ),
        item=_item(results),
        received="2026-11-18",
        begun_utc="2026-11-21T01:06:35Z",
        ended_utc="2026-11-21T01:07:02Z",
        issued_utc=ISSUED,
        method=Method(
            "SB-CAL-01", "3.2", "Camera before a collimator with a star target; joint least squares."
        ),
        deviations=(
            Deviation("Pose 4 (below) was skipped by the operator: too few stars.", "run"),
            Deviation("Warm-up of 20 min instead of 30 min.", "laboratory"),
        ),
        conditions=(
            Condition("camera temperature", 41.5, "\N{DEGREE SIGN}C", None, None, "", "run"),
            Condition("light frequency", 60.0006, "Hz", None, None, "", "run"),
            Condition(
                "room temperature",
                20.3,
                "\N{DEGREE SIGN}C",
                0.4,
                2.0,
                "",
                "Testo 635, certificate T-2026-114",
            ),
            Condition("relative humidity", 45.0, "%", 4.0, 2.0, "", "Testo 635, certificate T-2026-114"),
            Condition("warm-up", None, "1", None, None, "20 min with the camera on", "laboratory"),
        ),
        traceability=(
            Traceability(
                "focal length of the collimator",
                255.0,
                0.1,
                2.0,
                "mm",
                "SIM-2026-01",
                "PTB",
                "2026-01-12",
                "e328549503ebda4e41bac7e0be61ebd9acafde83372e242199aa90678c1d9d7b",
                "Traceable to the SI.",
            ),
            Traceability(
                "coordinates of the stars on the target",
                None,
                None,
                None,
                "1",
                "",
                "",
                "",
                "",
                "Drawing only.",
            ),
        ),
        results=_results(calibration),
        covariance=_covariance(calibration),
        further=(
            FurtherResult(
                "projection_worst_corner",
                "expanded projection uncertainty at the worst corner (top left)",
                projection["worst_corner"]["expanded_px"],
                "px",
                "0.61 px",
            ),
            FurtherResult(
                "projection_worst_corner",
                "expanded projection uncertainty at the worst corner (top left)",
                35.9,
                "arcsec",
                "36\N{DOUBLE PRIME}",
            ),
            FurtherResult(
                "projection_median",
                "expanded projection uncertainty, median over the image",
                projection["median"]["expanded_px"],
                "px",
                "0.28 px",
            ),
            FurtherResult("rms", "RMS of the residuals", calibration["rms_px"], "px", "0.081 px"),
            FurtherResult("views", "number of views", 3.0, "1", "3"),
        ),
        budgets=tuple(_budget(calibration, symbol) for symbol in NAMES),
        before_adjustment=BeforeAdjustment(
            "Certificate SB-2025-00104 of this laboratory",
            "SB-2025-00104",
            "2025-11-20",
            "cd" * 32,
            (ValueBefore("fx", 3345.1, 2.9, "px"), ValueBefore("k1", 0.051, None, "1")),
            0.21,
            0.74,
        ),
        conformity=(
            Conformity(
                "fx",
                "Customer drawing 4711, focal length",
                3340.0,
                3350.0,
                "px",
                2.5,
                "Guard band w = U: pass if the value lies inside the limits by U or more (ILAC-G8, 4.2.2).",
                "pass",
            ),
            Conformity(
                "k2", "Customer drawing 4711", None, -0.5, "1", 0.36, "Guard band w = U.", "conditionalPass"
            ),
        ),
        customer_supplied=("Pixel pitch 4.86 \N{MICRO SIGN}m: from the data sheet of the camera.",),
        external=("Humidity sensor calibrated by Klimalabor GmbH.",),
        opinions=("Opinion: the focus ring should be locked with a screw.",),
        authorised_by=AuthorisedBy("Dr. Grace Hopper", "Head of laboratory", "SHA256:" + "A" * 43),
        run=_run(results, data),
        amends=Amends(
            "SIMULATED-SB-2026-00016",
            "ef" * 32,
            "The customer's address was wrong.",
            (Change("customer.address.street", "Mill Lane 2", "Mill Lane 3"),),
        ),
        statements=STATEMENTS,
    )


def small_certificate():
    """The least that a certificate can have: of a real bench, without anything optional."""
    full = full_certificate()
    return dataclasses.replace(
        full,
        title="Calibration certificate",
        number="SB-2026-00018",
        simulated=False,
        laboratory=dataclasses.replace(full.laboratory, accreditation=None),
        deviations=(),
        conformity=(),
        before_adjustment=None,
        customer_supplied=(),
        external=(),
        opinions=(),
        amends=None,
        statements=STATEMENTS[1:],
        item=dataclasses.replace(full.item, customer_id=""),
    )
