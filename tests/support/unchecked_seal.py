"""A seal of what the bench itself refuses: toy folders, and those of somebody who has the bench's key."""

from unittest import mock

from bench.evidence.seal import seal_folder


def seal_unchecked(path, key):
    with mock.patch("bench.evidence.seal.check_content"):
        return seal_folder(path, key)
