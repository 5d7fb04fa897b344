"""Calls of the system that are refused, to be put in place of the real ones; and documents that are."""

import errno
import os

import pytest

from sequences.errors import DocumentFaults


def full(*_args, **_more):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def denied(path, *_args, **_more):
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def faults_of(read, *words):
    """Read a wrong document; return its faults as texts."""
    with pytest.raises(DocumentFaults) as refused:
        read(*words)
    return [str(fault) for fault in refused.value.faults]
