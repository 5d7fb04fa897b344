"""The token of the pages: where it comes from, and what is refused."""

from __future__ import annotations

import os

import pytest

from bench.base.errors import UsageError
from bench.web.tokens import TOKEN_VARIABLE, page_token, require_token


def test_the_token_comes_from_the_environment_or_a_file(tmp_path):
    path = tmp_path / "token"
    path.write_text("from-a-file-123\n")
    path.chmod(0o600)
    assert page_token(None, {}) is None
    assert page_token(None, {TOKEN_VARIABLE: "from-the-environment"}) == "from-the-environment"
    assert page_token(path, {TOKEN_VARIABLE: "from-the-environment"}) == "from-a-file-123"


@pytest.mark.parametrize("token", ["short", "with\x00control-characters"])
def test_a_weak_token_is_refused(token):
    with pytest.raises(UsageError, match="at least 12 printable"):
        page_token(None, {TOKEN_VARIABLE: token})


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such permissions")
def test_a_file_that_others_may_read_is_refused(tmp_path):
    path = tmp_path / "token"
    path.write_text("0123456789abcdef")
    path.chmod(0o644)
    with pytest.raises(UsageError, match="Other users may read"):
        page_token(path, {})


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    tmp_path.chmod(0o700)
    with pytest.raises(UsageError, match="cannot be read"):
        page_token(tmp_path / "none", {})
    with pytest.raises(UsageError, match="not a file with a token"):
        page_token(tmp_path, {})


def test_other_computers_need_a_token():
    require_token("127.0.0.1", None)
    require_token("0.0.0.0", "0123456789abcdef")
    with pytest.raises(UsageError, match="need a token"):
        require_token("0.0.0.0", None)
