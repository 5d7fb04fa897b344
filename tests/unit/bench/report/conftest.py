"""A report of the sample results."""

import pytest
from report_sample import SMALL, sample

from bench.report.html import render_report


@pytest.fixture(scope="session")
def data():
    return sample(size=SMALL)


@pytest.fixture(scope="session")
def html(data):
    return render_report(data)
