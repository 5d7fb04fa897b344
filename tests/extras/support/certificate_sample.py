"""Certificates for tests: a full one with the numbers of a real simulated run, and a small one."""

import dataclasses
import functools

from sealed_bench import RESULTS, sample_results

from bench.evidence.findings import Verification
from bench.extras.certificate.certificate_data import (
    Amends,
    BeforeAdjustment,
    Certificate,
    Change,
    Deviation,
    Run,
    ValueBefore,
)
from bench.extras.certificate.compose import Identity, compose
from bench.extras.certificate.dcc import render_dcc
from bench.extras.certificate.lab_config import LabConfig
from bench.extras.certificate.sealed_run import stated_run
from sequences.reader import check_document

ISSUED = "2026-11-21T08:30:00Z"
KEY = "SHA256:" + "A" * 43
FAILED = "1 FAIL against Customer drawing 4711, focal length"
LAB = f"""\
format: starbench/lab/1
numbers: {{format: "SB-{{year}}-{{number:05d}}"}}
laboratory:
  name: Optical Laboratory Ltd \N{EN DASH} Kalibrierlabor f\N{LATIN SMALL LETTER U WITH DIAERESIS}r Kameras
  address: {{street: Sternstra\N{LATIN SMALL LETTER SHARP S}e 5, post_code: 38116, city: Braunschweig, country: DE}}
  contact: {{name: Calibration office, email: office@lab.example, phone: +49 531 000000}}
  accreditation: {{body: DAkkS, number: D-K-00000-01-00, scope: Geometric calibration of cameras}}
place: {{kind: laboratory, name: "Room 2.17, Sternstra\N{LATIN SMALL LETTER SHARP S}e 5, Braunschweig"}}
customer:
  name: Customer & Sons <GmbH>
  address: {{street: Mill Lane 3, post_code: CB2 1RX, city: Cambridge, country: GB}}
  contact: {{name: Ada Byron, email: ada@customer.example}}
item:
  serial: 00050423
  lens:
    {{maker: Kowa, model: LM16JC10M, serial: 0042-17, focus: infinity, focus_locked: true, aperture: f/2.8,
     aperture_locked: true}}
  customer_id: Inventory 2231 <b>&
  received: 2026-11-18
  condition: No visible damage; front lens clean.
method: {{id: SB-CAL-01, version: 3.2, text: Camera before a collimator with a star target; joint least squares.}}
deviations: [Warm-up of 20 min instead of 30 min.]
conditions:
  - {{name: room temperature, value: 20.3, unit: \N{DEGREE SIGN}C, uncertainty: 0.4, instrument: Testo 635, certificate: T-2026-114}}
  - {{name: relative humidity, value: 45, unit: "%", uncertainty: 4, instrument: Testo 635, certificate: T-2026-114}}
  - {{name: warm-up, text: 20 min with the camera on}}
traceability: To the SI, by the certificates listed.
sources:
  - {{row: passport of the collimator, issuer: PTB, statement: Traceable to the national standard of length.}}
  - {{row: scale of the print, what: coordinates of the stars, number: R-17, issuer: Mask shop GmbH, date: 2026-01-08}}
decision_rules:
  - {{result: fx, specification: "Customer drawing 4711, focal length", lower: 3340, upper: 3347}}
  - {{result: k2, specification: Customer drawing 4711, upper: -0.5}}
previous_certificate: {{number: SB-2025-00104, date: 2025-11-20, sha256: {"cd" * 32}}}
customer_supplied:
  - {{text: "Pixel pitch 4.86 \N{MICRO SIGN}m: from the data sheet of the camera."}}
external: [Humidity sensor calibrated by Klimalabor GmbH.]
opinions: ["Opinion: the focus ring should be locked with a screw."]
authorised_by: {{name: Dr. Grace Hopper, role: Head of laboratory, key: "{KEY}"}}
"""
"""A lab.yaml with everything in it, for the camera of the sample."""


def sample_lab(text=LAB):
    """The sample's lab.yaml, with the place of each value."""
    return check_document(text.encode(), "lab.yaml", LabConfig)


def identity(**facts):
    run = Run(
        **stated_run(sample_results(), RESULTS.read_bytes(), ()),
        journal_head="4f" * 32,
        seal_sha256="5e" * 32,
        signer="bench@lab",
        signer_fingerprint="SHA256:Sces8o9+LQPy9Z1snLqj6+sutjM38veePqEncDBU3Tc",
    )
    return Identity(**{"number": "SIMULATED-SB-2026-00017", "issued_utc": ISSUED, "run": run, **facts})


def full_certificate() -> Certificate:
    """A certificate with everything in it, of the simulated run of `sample_results`."""
    changes = (Change("customer.address.street", "Mill Lane 2", "Mill Lane 3"),)
    reason = "The customer's address was wrong."
    amends = Amends("SIMULATED-SB-2026-00016", "ef" * 32, reason, changes)
    verdicts = f"Runs of this camera on this bench, by its ledger: {FAILED}; 2 without limits."
    made = compose(sample_results(), sample_lab().value, identity(amends=amends, verdicts=verdicts))
    skipped = Deviation("Pose 4 (below) was skipped by the operator: too few stars.", "run")
    values = (ValueBefore("fx", 3345.1, 2.9, "px"), ValueBefore("k1", 0.051, None, "1"))
    source = "Certificate SB-2025-00104 of this laboratory"
    before = BeforeAdjustment(source, "SB-2025-00104", "2025-11-20", "cd" * 32, values, 0.21, 0.74)
    return dataclasses.replace(made, deviations=(skipped, *made.deviations), before_adjustment=before)


def small_certificate() -> Certificate:
    """The least that a certificate can have: of a real bench, without anything optional."""
    full = full_certificate()
    nothing = dict.fromkeys(("deviations", "conformity", "customer_supplied", "external", "opinions"), ())
    return dataclasses.replace(
        full,
        title="Calibration certificate",
        number="SB-2026-00018",
        series="SB-{year}-{number:05d}",
        simulated=False,
        laboratory=dataclasses.replace(full.laboratory, accreditation=None),
        before_adjustment=None,
        amends=None,
        statements=tuple(
            statement for statement in full.statements if statement.id not in ("simulated", "customer_data")
        ),
        item=dataclasses.replace(full.item, customer_id=""),
        **nothing,
    )


@functools.cache
def full_dcc() -> bytes:
    """A DCC with everything in it, of simulated devices."""
    return render_dcc(full_certificate())


@functools.cache
def small_dcc() -> bytes:
    """A DCC with nothing optional, of a real camera."""
    small = small_certificate()
    camera = dataclasses.replace(small.item.camera, model="EVK4", firmware="4.2.0")
    return render_dcc(dataclasses.replace(small, item=dataclasses.replace(small.item, camera=camera)))


def verified(folder, **facts):
    """What the verifier says of a folder in order."""
    kind = "certificate" if (folder / "certificate.json").exists() else "run"
    known = {"kind": kind, "signer": "bench@lab", "fingerprint": KEY, "state": "SEALED"}
    return Verification(folder=str(folder), **{**known, **facts})
