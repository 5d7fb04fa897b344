"""A file system of a test's own, in a file: its power is cut, or it stands still. Needs root, mkfs.ext4 and loop devices."""

import fcntl
import os
import shutil
import struct
import subprocess

import pytest

SHUTDOWN = 0x8004587D  # FS_IOC_SHUTDOWN, linux/fs.h
WITHOUT_LOG_FLUSH = 2
FREEZE, THAW = 0xC0045877, 0xC0045878  # FIFREEZE, FITHAW, linux/fs.h


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, check=False)


class Disk:
    """A file system in a file."""

    def __init__(self, folder):
        if os.geteuid() != 0:
            pytest.skip("a file system of our own needs root")
        if shutil.which("mkfs.ext4") is None:
            pytest.skip("mkfs.ext4 is not installed")
        self.image, self.mounted = folder / "disk.img", folder / "disk"
        self.mounted.mkdir()
        with self.image.open("wb") as image:
            image.truncate(512 << 20)  # for what a fast computer writes in eight seconds
        made = run("mkfs.ext4", "-q", "-F", self.image)
        if made.returncode or (mounted := run("mount", "-o", "loop", self.image, self.mounted)).returncode:
            pytest.skip(
                f"a file system of our own cannot be had here: {(made.stderr or mounted.stderr).strip()}"
            )

    def cut_power(self):
        self._order(SHUTDOWN, struct.pack("I", WITHOUT_LOG_FLUSH))

    def freeze(self):
        """Let every process that writes wait in the kernel."""
        self._order(FREEZE, 0)

    def thaw(self):
        self._order(THAW, 0)

    def _order(self, number, argument):
        descriptor = os.open(self.mounted, os.O_RDONLY)
        fcntl.ioctl(descriptor, number, argument)
        os.close(descriptor)

    def mount_again(self):
        assert run("umount", self.mounted).returncode == 0
        again = run("mount", "-o", "loop", self.image, self.mounted)
        assert again.returncode == 0, again.stderr

    def close(self):
        run("umount", self.mounted)
