"""Calls of the system that are refused, to be put in place of the real ones."""

import errno
import os


def full(*_args, **_more):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def denied(path, *_args, **_more):
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
