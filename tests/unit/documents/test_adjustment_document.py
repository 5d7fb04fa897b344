"""The page of the joint adjustment: its letters are those of the code, and its priors are those that the code has."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from calib.joint import amplitudes, doubts, equations, hypotheses, knowledge, marginal, prior

PAGE = (Path(__file__).parents[3] / "docs" / "adjustment.md").read_text(encoding="utf-8")
#: What the page writes in TeX, as the head of the module writes it.
PLAIN = (
    (r"\mathsf T", "T"),
    (r"\,", ""),
    (r"\log", "log"),
    (r"\Omega", "Omega"),
    (r"\Sigma", "Sigma"),
    (r"\Pi", "Pi"),
)
CLASSES = {
    kind.__name__: kind
    for kind in (
        equations.State,
        equations.Equations,
        marginal.Solution,
        amplitudes.Hyperprior,
        prior.RandomPrior,
        knowledge.Statement,
        doubts.Innovation,
        doubts.Unstated,
    )
}


def letters_of_the_page():
    table = PAGE.partition("| letter | in the code |")[2].partition("\n\n")[0]
    for letters, names, _ in re.findall(r"^\| (\$.+?) \| (`.+?) \| (.+) \|$", table, re.MULTILINE):
        for tex, plain in PLAIN:
            letters = letters.replace(tex, plain)  # noqa: PLW2901
        yield re.sub(r"[${} ]", "", letters), re.findall(r"`(.+?)`", names)


def letters_of_the_module():
    rows = re.findall(r"^(\S.*?)  +(`.+)$", marginal.__doc__, re.MULTILINE)
    return {letters.replace(" ", ""): re.findall(r"`(.+?)`", names) for letters, names in rows}


def amplitudes_of_the_page():
    """Names of amplitudes with median and 1 sigma of the logarithm, as the page has them."""
    table = PAGE.partition("| amplitude | median |")[2].partition("\n\n")[0]
    for names, medians, sigmas in re.findall(r"^\| ([a-z].+?) \| (.+?) \| (.+?) \|", table, re.MULTILINE):
        own, values = [name.removesuffix(", by degree") for name in names.split("; ")], medians.split("; ")
        widths = sigmas.split("; ")
        for k, (name, median) in enumerate(zip(own, values, strict=True)):
            yield name, float(median), float(widths[k % len(widths)])


def test_the_page_and_the_module_have_the_same_letters():
    assert dict(letters_of_the_page()) == letters_of_the_module()


def test_every_letter_is_a_name_of_the_code():
    names = [name for own in letters_of_the_module().values() for name in own]
    assert len(names) > 15
    for name in names:
        kind, _, part = name.partition(".")
        source = inspect.getsource(CLASSES[kind])
        assert re.search(rf"^    {part}: |def {part}\(|self\.{part}(, .+)? = ", source, re.MULTILINE), name


def test_the_page_has_the_prior_of_every_amplitude():
    expected = {}
    for family in amplitudes.FAMILIES:
        sigma = float(np.sqrt(family.level**2 + family.glass**2 + family.scatter**2))
        for name, median in reversed(list(zip(family.names, family.medians, strict=True))):
            expected[name.partition(", degree")[0].removeprefix("field ")] = median, sigma
    stated = {
        name.removeprefix("field "): (median, sigma) for name, median, sigma in amplitudes_of_the_page()
    }
    assert stated.keys() == expected.keys()
    for name, (median, sigma) in stated.items():
        assert median == pytest.approx(expected[name][0], rel=0.02), name
        assert sigma == pytest.approx(expected[name][1], abs=0.06), name


def test_the_page_lists_every_hypothesis_with_its_odds():
    table = PAGE.partition("| hypothesis | odds |")[2].partition("\n\n")[0]
    stated = {
        name: float(odds) for name, odds in re.findall(r"^\| ([a-z].+?) \| (.+?) \|$", table, re.MULTILINE)
    }
    every = [each for each in vars(hypotheses).values() if isinstance(each, hypotheses.Hypothesis)]
    assert stated == {hypothesis.name: pytest.approx(hypothesis.odds, rel=0.02) for hypothesis in every}
