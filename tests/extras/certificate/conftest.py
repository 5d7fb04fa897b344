"""A laboratory that issues certificates quickly: without PDF and plots."""

from unittest import mock

import pytest
from certificate_lab import Lab, quick_files

from bench.extras.certificate import issue as issue_module


@pytest.fixture
def lab(tmp_path):
    with (
        mock.patch.object(issue_module, "certificate_files", quick_files),
        mock.patch("bench.extras.certificate.pdf.plots_of_run", return_value={}),
    ):
        yield Lab(tmp_path)
