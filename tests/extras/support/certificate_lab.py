"""A laboratory that issues certificates from a sealed run, for tests and benchmarks."""

from certificate_sample import LAB, verified
from refusals import faults_of
from sealed_bench import SealedBench

from bench.evidence.keys import ensure_key
from bench.extras.certificate.amend import amend
from bench.extras.certificate.issue import Issuer, issue
from bench.extras.certificate.series import numbers

FIRST = "SIMULATED-SB-2026-00001"


class Lab(SealedBench):
    """A laboratory with one sealed run."""

    def __init__(self, path):
        super().__init__(path)
        self.says = {}
        self.lab = path / "lab.yaml"
        self.lab.write_text(LAB, encoding="utf-8")

    def laboratory(self):
        clock, key = (lambda: self.now), (lambda: ensure_key(self.home))
        return Issuer(self.ledger, key, clock, lambda f: verified(f, **self.says))

    def issue(self, name="certificate", **facts):
        return issue(self.run, self.lab, self.path / name, self.laboratory(), **facts)

    def amend(self, old, name, reason="wrong address", old_text="Mill Lane 3", new_text="Mill Lane 4"):
        self.lab.write_text(LAB.replace(old_text, new_text), encoding="utf-8")
        return amend(self.path / old, self.lab, self.path / name, self.laboratory(), reason=reason)

    def numbers(self):
        return {entry.number: entry.how for entry in numbers(self.ledger.entries()).values()}

    def faults(self, text):
        self.lab.write_text(text, encoding="utf-8")
        faults = faults_of(self.issue)
        assert self.numbers() == {}, "a number was taken for a refused certificate"
        return faults


def quick_files(certificate, content, results, lab, plots):
    """The files without PDF, DCC and plots, which take half a second."""
    return {"certificate.json": certificate.to_json(), "results.json": results, "lab.yaml": lab}
