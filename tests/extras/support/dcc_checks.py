"""Does a digital calibration certificate of ours contradict itself: what PTB's schema and the rules of dcclib do not ask.

Each check yields a line for each fault. It reads the file by itself; only words and units are those of the product.
"""

import math
import re
from datetime import date
from decimal import Decimal

import numpy as np
from lxml import etree
from scipy.special import chdtri

from bench.extras.certificate.d_si import PREFIXES, is_unit, product
from bench.extras.certificate.dcc_xml import NAMESPACES

SIMULATED = "SIMULATED"
STATISTIC, LIMIT = "starbench_statistic", "starbench_limit"
BUDGET, EARLIER, JOINT = "starbench_budgetEntry", "starbench_earlierValue", "starbench_jointCovariance"
DEGREES_OF_FREEDOM = "starbench_effectiveDegreesOfFreedom"
CORE = "dcc:administrativeData/dcc:coreData"
LIST = "si:realListXMLList"
OF_RESULTS = ".//dcc:result//dcc:quantity[si:real][not(ancestor::dcc:metaData)]"
WITHOUT_UNCERTAINTY = {STATISTIC, BUDGET, EARLIER, DEGREES_OF_FREEDOM, LIMIT}


def check_dcc(data: bytes) -> list[str]:
    """Return one line a fault; empty if there is none."""
    root = etree.fromstring(data)
    return [fault for check in CHECKS for fault in check(root)]


def find(root, path):
    return root.xpath(path, namespaces=NAMESPACES)


def text(root, path: str) -> str:
    return root.findtext(path, "", NAMESPACES).strip()


def kinds(element) -> set[str]:
    return set(element.get("refType", "").split())


def dates(root):
    names = ("receiptDate", "beginPerformanceDate", "endPerformanceDate", "issueDate")
    days = [date.fromisoformat(day[:10]) for name in names if (day := text(root, f"{CORE}/dcc:{name}"))]
    if days != sorted(days) or len(days) < 3:
        yield f"dates are missing or out of order: {days}"


def amendments(root):
    replaced = text(root, f"{CORE}/dcc:reportAmendedSubstituted/dcc:replacedUniqueIdentifier")
    if replaced != text(root, f"{CORE}/dcc:previousReport/dcc:referralID"):
        yield "reportAmendedSubstituted and previousReport name two certificates"
    if replaced == text(root, f"{CORE}/dcc:uniqueIdentifier"):
        yield "the certificate replaces itself"
    for linked in find(root, "//dcc:previousReport | //dcc:certificate | //dcc:linkedReport"):
        if text(linked, "dcc:procedure") != "SHA-256" or not re.fullmatch(
            "[0-9a-f]{64}", text(linked, "dcc:value")
        ):
            yield f"line {linked.sourceline}: this is not a hash by SHA-256"


def simulated(root):
    """A certificate of simulated devices says so in each place, any other in none."""
    signs = {
        "number": SIMULATED in text(root, f"{CORE}/dcc:uniqueIdentifier"),
        "title": SIMULATED in text(root, ".//dcc:measurementResult/dcc:name/dcc:content"),
        "item": SIMULATED in text(root, ".//dcc:item/dcc:name/dcc:content"),
        "statement": any(SIMULATED in content.text for content in find(root, "//dcc:statement//dcc:content")),
        "comment": bool(find(root, "dcc:comment/*[@simulated='true']")),
    }
    if len(set(signs.values())) != 1:
        yield f"simulated here, and not there: {signs}"


def units_and_numbers(root):
    for number in find(root, "//si:*[not(*)]"):
        name, words = etree.QName(number).localname, (number.text or "").split()
        if "nit" in name:
            yield from (f"{name}: {word} is no unit of D-SI" for word in words or [""] if not is_unit(word))
        elif not re.search("abel|istribution", name):
            yield from (f"{name}: {word} is not a number" for word in words or [""] if not finite(word))


def finite(word: str) -> bool:
    return re.fullmatch(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", word) is not None


class Result:
    """A number with its expanded uncertainty, as stated in ``si:real``."""

    def __init__(self, quantity) -> None:
        real = quantity.find("si:real", NAMESPACES)
        self.id, self.label = quantity.get("id", ""), text(real, "si:label")
        self.unit, self.value = text(real, "si:unit"), Decimal(text(real, "si:value"))
        self.U, k = (
            Decimal(text(real, f"si:expandedUnc/si:{name}")) for name in ("uncertainty", "coverageFactor")
        )
        self.k = float(k)

    @property
    def step(self) -> float:
        """One unit of the last digit of U; of its second digit where it is a whole number."""
        exponent = int(self.U.as_tuple().exponent)
        return 10.0 ** (exponent if exponent < 0 else max(exponent, self.U.adjusted() - 1))

    def is_expanded(self, sigma: float) -> bool:
        """Whether U is k times a standard uncertainty, rounded to U's digits or upwards."""
        exact = self.k * sigma
        return exact - 0.51 * self.step <= float(self.U) <= 1.001 * exact + self.step


def results(root) -> list[Result]:
    return [Result(node) for node in find(root, OF_RESULTS) if not kinds(node) & WITHOUT_UNCERTAINTY]


def joint_list(root):
    """The list with all digits has the results' labels, values and units, and a covariance that gives their U."""
    (quantity,) = [listed for listed in find(root, "//dcc:quantity") if JOINT in kinds(listed)]
    stated = {result.id: result for result in results(root) if result.id}
    members = [stated.pop(member) for member in quantity.get("refId").split()]
    if stated:
        yield f"the joint covariance lacks {sorted(stated)}"
    if text(quantity, f"{LIST}/si:labelXMLList").split() != [member.label for member in members]:
        yield "the joint list has other labels"
    units = [member.unit for member in members]
    if text(quantity, f"{LIST}/si:unitXMLList").split() not in (units, sorted(set(units))):
        yield "the joint list has other units"
    values = map(float, text(quantity, f"{LIST}/si:valueXMLList").split())
    for member, value in zip(members, values, strict=True):
        if abs(value - float(member.value)) > 0.51 * member.step:
            yield f"{member.label} is {member.value} as a result and {value} in the joint list"
    columns = [find(column, "si:covariance") for column in find(quantity, ".//si:column")]
    matrix = np.array([[float(text(row, "si:value")) for row in column] for column in columns])
    for i, column in enumerate(columns):
        for j, row in enumerate(column):
            if powers(text(row, "si:unit")) != powers(product(units[i], units[j])):
                yield f"the unit of the covariance {i}, {j} is not the product of two units"
    sigma = np.sqrt(np.diag(matrix))
    correlation = matrix / np.outer(sigma, sigma)
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0) or np.linalg.eigvalsh(correlation)[0] < -1e-9:
        yield "the covariance is not symmetric or not positive semi-definite"
    for member, each in zip(members, sigma, strict=True):
        if not member.is_expanded(each):
            yield f"U = {member.U} of {member.label} is not k times the root of the diagonal, {each}"
    region = find(quantity, ".//si:ellipsoidalRegionXMLList")[0]
    k, p = (float(text(region, f"si:{name}")) for name in ("coverageFactor", "coverageProbability"))
    if k < 0.97 * math.sqrt(chdtri(len(members), 1.0 - p)):  # JCGM 102:2011, 6.5
        yield f"the coverage factor {k} of the ellipsoid is too small"


def powers(unit: str) -> dict[str, int]:
    r"""Return the power of each unit, with its prefix, in a unit of D-SI; without ``\one``."""
    powers_of: dict[str, int] = {}
    prefix = last = ""
    sign = 1
    for word in unit.split("\\")[1:]:
        if word.startswith("tothe"):
            powers_of[last] += sign * (int(word[6:-1]) - 1)
        elif word == "per":
            sign = -1
        elif word in PREFIXES:
            prefix = word
        else:
            last, prefix = prefix + word, ""
            powers_of[last] = powers_of.get(last, 0) + sign
    return {name: power for name, power in powers_of.items() if power and name != "one"}


CHECKS = (dates, amendments, simulated, units_and_numbers, joint_list)
