"""The token of the pages: where it comes from, and what is refused."""

from __future__ import annotations

import os

import pytest

from bench.base.errors import UsageError
from bench.web.guard import TOKEN_VARIABLE, PageToken, page_token, require_token


def test_the_token_comes_from_the_environment_or_a_file(tmp_path):
    path = tmp_path / "token"
    path.write_text("from-a-file-123\n")
    path.chmod(0o600)
    environ = {TOKEN_VARIABLE: "from-the-environment"}
    assert page_token(None, environ=environ) == PageToken("from-the-environment")
    assert page_token(path, environ=environ) == PageToken("from-a-file-123")


def test_without_one_each_start_makes_a_token_that_nobody_can_guess():
    made = {page_token(None, environ={}).text for _ in range(100)}
    assert len(made) == 100
    assert min(map(len, made)) >= 22  # 128 bits
    assert page_token(None, environ={}).made


def test_no_token_must_be_said_and_said_alone(tmp_path):
    assert page_token(None, none=True, environ={TOKEN_VARIABLE: "from-the-environment"}) is None
    with pytest.raises(UsageError, match="exclude each other"):
        page_token(tmp_path / "token", none=True)


@pytest.mark.parametrize("token", ["short", "with\x00control-characters"])
def test_a_weak_token_is_refused(token):
    with pytest.raises(UsageError, match="at least 12 printable"):
        page_token(None, environ={TOKEN_VARIABLE: token})


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such permissions")
def test_a_file_that_others_may_read_is_refused(tmp_path):
    path = tmp_path / "token"
    path.write_text("0123456789abcdef")
    path.chmod(0o644)
    with pytest.raises(UsageError, match="Other users may read"):
        page_token(path, environ={})


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    tmp_path.chmod(0o700)
    with pytest.raises(UsageError, match="cannot be read"):
        page_token(tmp_path / "none", environ={})
    with pytest.raises(UsageError, match="not a file with a token"):
        page_token(tmp_path, environ={})


def test_other_computers_need_a_token():
    require_token("127.0.0.1", None)
    require_token("0.0.0.0", PageToken("0123456789abcdef"))
    with pytest.raises(UsageError, match="need a token"):
        require_token("0.0.0.0", None)
