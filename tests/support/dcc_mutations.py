"""Digital calibration certificates with one fault each, and what must find it: our checks, PTB's schema, or both."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import certificate_sample
from lxml import etree

from bench.certificate.dcc import render_dcc
from bench.certificate.dcc_xml import NAMESPACES

FX = "//dcc:quantity[@id='result-fx']"
JOINT = "//si:realListXMLList"
COLUMN = f"{JOINT}//si:column"
CORE = "//dcc:coreData"


@cache
def full_dcc():
    """A DCC with everything in it, of simulated devices."""
    return render_dcc(certificate_sample.full_certificate())


@cache
def small_dcc():
    """A DCC with nothing optional, of a real camera."""
    small = certificate_sample.small_certificate()
    camera = dataclasses.replace(small.item.camera, model="EVK4", firmware="4.2.0")
    return render_dcc(dataclasses.replace(small, item=dataclasses.replace(small.item, camera=camera)))


@dataclass(frozen=True)
class Mutation:
    """A change, and what finds it: a part of the message of our checks (empty: none), and whether the schema does."""

    name: str
    change: Callable
    ours: str
    schema: bool

    def apply(self):
        """Return the changed DCC."""
        root = etree.fromstring(full_dcc())
        before = etree.tostring(root)
        self.change(root)
        after = etree.tostring(root)
        assert after != before, "the mutation changes nothing"
        return after


def find(root, path):
    found = root.xpath(path, namespaces=NAMESPACES)
    assert found, path
    return found


def text(path, new, every=False):
    def change(root):
        for one in find(root, path)[: None if every else 1]:
            one.text = new

    return change


def drop(path, every=False):
    def change(root):
        for one in find(root, path)[: None if every else 1]:
            one.getparent().remove(one)

    return change


def attribute(path, name, new):
    def change(root):
        one = find(root, path)[0]
        if new is None:
            del one.attrib[name]
        else:
            one.set(name, new)

    return change


def element(i, j):
    return f"({COLUMN})[{j + 1}]/si:covariance[{i + 1}]/si:value"


def words(path, at, new):
    """Replace a word of an XML list."""

    def change(root):
        one = find(root, path)[0]
        parts = one.text.split()
        parts[at] = new
        one.text = " ".join(parts)

    return change


def without_last_result(root):
    """Take k2 out of the joint list, consistently."""
    for path in ("labelXMLList", "valueXMLList", "unitXMLList"):
        one = find(root, f"{JOINT}/si:{path}")[0]
        one.text = " ".join(one.text.split()[:5])
    quantity = find(root, f"{JOINT}/..")[0]
    quantity.set("refId", " ".join(quantity.get("refId").split()[:5]))
    drop(f"({COLUMN})[6]")(root)
    for column in find(root, COLUMN):
        column.remove(column[5])


def comment_in_value(root):
    value = find(root, f"{FX}/si:real/si:value")[0]
    value.text, rest = "33", "46.4"
    hidden = etree.Comment(" ")
    hidden.tail = rest
    value.append(hidden)


def swapped(root):
    core = find(root, CORE)[0]
    core.insert(0, core[3])


def unknown_element(root):
    find(root, CORE)[0].append(etree.Element(f"{{{NAMESPACES['dcc']}}}extra"))


def not_semi_definite(root):
    for i, j in ((0, 1), (1, 0)):
        text(element(i, j), "9.5")(root)


UNC = f"{FX}/si:real/si:expandedUnc"
BUDGET_ROW = "(//dcc:quantity[dcc:name/dcc:content='contribution to the standard uncertainty'])[1]//si:value"
BUDGET_SUM = "(//dcc:quantity[dcc:name/dcc:content='combined standard uncertainty'])[1]//si:value"
CONFORMITY = "(//dcc:statement[dcc:conformity])[1]"

MUTATIONS = (
    Mutation("unit of no system", text(f"{FX}/si:real/si:unit", "foo"), "foo is not a unit of D-SI", False),
    Mutation(
        "pixel as a unit", text(f"{FX}/si:real/si:unit", r"\pixel"), "D-SI knows no unit or prefix", False
    ),
    Mutation("empty unit", text(f"{FX}/si:real/si:unit", ""), "is not a unit of D-SI", False),
    Mutation(
        "two prefixes",
        text("//dcc:influenceCondition//si:unit", r"\milli\milli\metre"),
        "two prefixes",
        False,
    ),
    Mutation(
        "unknown unit in a list", words(f"{JOINT}/si:unitXMLList", 0, r"\px"), "is not a unit of D-SI", False
    ),
    Mutation("no uncertainty", drop(UNC), "fx has no uncertainty", False),
    Mutation("uncertainty of zero", text(f"{UNC}/si:uncertainty", "0.0"), "must be above 0", False),
    Mutation("negative uncertainty", text(f"{UNC}/si:uncertainty", "-2.5"), "must be above 0", True),
    Mutation("value NaN", text(f"{FX}/si:real/si:value", "NaN"), "NaN is not a finite decimal number", True),
    Mutation(
        "value infinite", text(f"{FX}/si:real/si:value", "INF"), "INF is not a finite decimal number", True
    ),
    Mutation(
        "decimal comma", text(f"{FX}/si:real/si:value", "3346,4"), "is not a finite decimal number", True
    ),
    Mutation("number in words", text(f"{UNC}/si:uncertainty", "two"), "is not a finite decimal number", True),
    Mutation("k below 1", text(f"{UNC}/si:coverageFactor", "0.5"), "must be from 1", True),
    Mutation(
        "k of another probability", text(f"{UNC}/si:coverageFactor", "3"), "does not belong to p", False
    ),
    Mutation(
        "probability in percent", text(f"{UNC}/si:coverageProbability", "95"), "must be from 0 to 1", True
    ),
    Mutation(
        "probability of zero", text(f"{UNC}/si:coverageProbability", "0"), "coverageProbability is 0", False
    ),
    Mutation(
        "probability 0.99 with k of 0.95",
        text(f"{UNC}/si:coverageProbability", "0.99"),
        "does not belong",
        False,
    ),
    Mutation(
        "few degrees of freedom",
        text(f"{FX}/dcc:measurementMetaData//si:value", "3"),
        "does not belong",
        False,
    ),
    Mutation(
        "half a degree of freedom",
        text(f"{FX}/dcc:measurementMetaData//si:value", "0.5"),
        "least is 1",
        False,
    ),
    Mutation("three digits of U", text(f"{UNC}/si:uncertainty", "2.41"), "has 3 digits", False),
    Mutation("value at another digit", text(f"{FX}/si:real/si:value", "3346.43"), "same digit", False),
    Mutation("column of the covariance missing", drop(f"({COLUMN})[6]"), "5 columns for 6 results", False),
    Mutation(
        "row of the covariance missing",
        drop(f"({COLUMN})[3]/si:covariance[2]"),
        "5 rows for 6 results",
        False,
    ),
    Mutation("covariance NaN", text(element(1, 2), "NaN"), "NaN in the covariance", True),
    Mutation("covariance not symmetric", text(element(0, 2), "0.3"), "not symmetric", False),
    Mutation("covariance not semi-definite", not_semi_definite, "not positive semi-definite", False),
    Mutation("negative variance", text(element(3, 3), "-7.0"), "must be above 0", False),
    Mutation(
        "variance doubled", text(element(3, 3), "14.9"), "is not k times the root of the diagonal", False
    ),
    Mutation(
        "unit of a covariance",
        text(f"({COLUMN})[1]/si:covariance[2]/si:unit", r"\metre"),
        "in the covariance is not",
        False,
    ),
    Mutation("no covariance", drop(f"{JOINT}/si:ellipsoidalRegionXMLList"), "has no covariance", False),
    Mutation("no joint list", drop(f"//dcc:result[.{JOINT}]"), "have no joint covariance", False),
    Mutation("a result less in the covariance", without_last_result, "the joint covariance lacks k2", False),
    Mutation(
        "value of the joint list", words(f"{JOINT}/si:valueXMLList", 2, "640.0"), "in the joint list", False
    ),
    Mutation(
        "label of the joint list",
        words(f"{JOINT}/si:labelXMLList", 0, "fy"),
        "the joint list calls fx fy",
        False,
    ),
    Mutation(
        "small ellipsoid", text(f"{JOINT}//si:coverageFactor", "2"), "is too small for 6 results", False
    ),
    Mutation("row of a budget", text(BUDGET_ROW, "0.9"), "rows of the budget of fx add up", False),
    Mutation("row of a budget missing", drop("(//dcc:result[@refId]//dcc:list)[1]"), "add up to", False),
    Mutation(
        "sum of a budget", text(BUDGET_SUM, "1.2"), "combined standard uncertainty of its budget", False
    ),
    Mutation("number replaced by a dash", text(f"{CORE}/dcc:uniqueIdentifier", "-"), "has no number", False),
    Mutation("no number", text(f"{CORE}/dcc:uniqueIdentifier", ""), "has no number", True),
    Mutation(
        "serial numbers not stated",
        text("//dcc:item//dcc:value", "-", every=True),
        "no item has a serial number",
        False,
    ),
    Mutation(
        "no identifications",
        drop("//dcc:item/dcc:identifications", every=True),
        "no item has a serial number",
        True,
    ),
    Mutation("reference to nothing", attribute(CONFORMITY, "refId", "result-f"), "refers to no id", False),
    Mutation("id without reference", attribute("//dcc:usedMethod", "id", "method"), "nothing refers", False),
    Mutation(
        "id twice", attribute("//dcc:quantity[@id='result-fy']", "id", "result-fx"), "stands 2 times", True
    ),
    Mutation(
        "end before begin", text(f"{CORE}/dcc:endPerformanceDate", "2026-11-20"), "is before begin", False
    ),
    Mutation(
        "issued before the end", text(f"{CORE}/dcc:issueDate", "2025-11-21"), "issueDate 2025-11-21 is", False
    ),
    Mutation(
        "received after the begin", text(f"{CORE}/dcc:receiptDate", "2026-11-22"), "is before receipt", False
    ),
    Mutation("30 February", text(f"{CORE}/dcc:issueDate", "2026-02-30"), "is not a date", True),
    Mutation(
        "no statement SIMULATED",
        drop("//dcc:statement[@refType='starbench_simulated']"),
        "no statement says",
        False,
    ),
    Mutation(
        "number without SIMULATED", text(f"{CORE}/dcc:uniqueIdentifier", "SB-1"), "number does not say", False
    ),
    Mutation(
        "title without SIMULATED",
        text("//dcc:measurementResult/dcc:name/dcc:content", "Calibration certificate"),
        "name of its measurement does not say",
        False,
    ),
    Mutation(
        "item without SIMULATED",
        text("//dcc:item/dcc:name/dcc:content", "EVK4"),
        "name of no item says",
        False,
    ),
    Mutation("nobody signs", text("//dcc:mainSigner", "false"), "no person authorises", False),
    Mutation(
        "signer without a name", text("//dcc:person/dcc:name/dcc:content", "-"), "no person authorises", False
    ),
    Mutation("no persons", drop("//dcc:respPersons"), "no person authorises", True),
    Mutation("no customer", drop("//dcc:customer"), "the customer has no name", True),
    Mutation(
        "laboratory without a name",
        text("//dcc:contact/dcc:name/dcc:content", "-"),
        "laboratory has no",
        False,
    ),
    Mutation(
        "wrong verdict", text(f"{CONFORMITY}/dcc:conformity", "fail"), "the verdict on fx is fail", False
    ),
    Mutation(
        "verdict of another language",
        text(f"{CONFORMITY}/dcc:conformity", "bestanden"),
        "the verdict on",
        True,
    ),
    Mutation("limit moved", text(f"{CONFORMITY}//si:value", "3345.0"), "is conditionalPass", False),
    Mutation("no decision rule", drop(f"{CONFORMITY}/dcc:convention"), "no decision rule", False),
    Mutation("conformity of nothing", attribute(CONFORMITY, "refId", None), "names no result", False),
    Mutation(
        "hash too short", text("//dcc:certificate/dcc:value", "e328"), "is not a hash by SHA-256", False
    ),
    Mutation(
        "replaces itself",
        text(f"{CORE}//dcc:replacedUniqueIdentifier", "SIMULATED-SB-2026-00017"),
        "replaces itself",
        False,
    ),
    Mutation("no hash of the replaced one", drop(f"{CORE}/dcc:previousReport"), "has no hash of that", False),
    Mutation(
        "another one replaced",
        text(f"{CORE}/dcc:previousReport/dcc:referralID", "X"),
        "two certificates",
        False,
    ),
    Mutation("comment in a value", comment_in_value, "comment or instruction", False),
    Mutation("release without a letter", text("//dcc:release", "0.1.0"), "has not the form v1.2.3", False),
    Mutation(
        "undeclared language",
        attribute("//dcc:content", "lang", "fr"),
        "is not one of the certificate",
        False,
    ),
    Mutation("empty text", text("//dcc:declaration/dcc:content", " "), "a text is empty", False),
    Mutation("elements in another order", swapped, "", True),
    Mutation("unknown element", unknown_element, "", True),
    Mutation("country in words", text(f"{CORE}/dcc:countryCodeISO3166_1", "Germany"), "", True),
    Mutation("unknown place", text(f"{CORE}/dcc:performanceLocation", "moon"), "", True),
    Mutation("mail address missing its element", text("//dcc:eMail", " "), "", True),
)
"""Each with one fault that a laboratory or an attacker can make."""
