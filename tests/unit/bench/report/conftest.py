"""A report of the sample results."""

import copy

import pytest
from report_sample import SMALL, sample

from bench.report.html import render_report


@pytest.fixture(scope="session")
def data():
    return sample(size=SMALL)


@pytest.fixture
def results(data):
    """The results of the report, for a test to change."""
    return copy.deepcopy(dict(data.results))


@pytest.fixture(scope="session")
def html(data):
    return render_report(data)
