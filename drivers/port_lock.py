"""Reserve an open serial port for one program: by flock, then by TIOCEXCL.

Two locks are taken, because one is not enough. flock is advisory: a program that does not ask for it ignores it.
TIOCEXCL makes the kernel refuse every further open, except by root. Both vanish with the process that took them,
however it ended, so no stale lock is left behind. Nothing but the open port is touched.
"""

from __future__ import annotations

import contextlib

from drivers import file_lock

try:
    import fcntl
    import termios
except ImportError:  # Windows opens every serial port exclusively by itself.

    def lock_exclusively(descriptor: int) -> None:
        """Do nothing: the system has locked the port at opening."""

    def unlock(descriptor: int) -> None:
        """Do nothing: the system unlocks the port at closing."""

    def disable_hang_up_on_close(descriptor: int) -> None:
        """Do nothing: the system has no such setting."""

else:

    def lock_exclusively(descriptor: int) -> None:
        """Lock an open port. Locking the same descriptor again does no harm.

        Raises BlockingIOError: Another program has locked the port.
        """
        file_lock.lock(descriptor)
        # A device that is no terminal has no TIOCEXCL; the flock still holds.
        with contextlib.suppress(OSError):
            fcntl.ioctl(descriptor, termios.TIOCEXCL)

    def unlock(descriptor: int) -> None:
        """Release the kernel's exclusive lock, which belongs to the terminal and not to the descriptor."""
        with contextlib.suppress(OSError):
            fcntl.ioctl(descriptor, termios.TIOCNXCL)

    def disable_hang_up_on_close(descriptor: int) -> None:
        """Clear HUPCL: closing then leaves DTR as it is, so a board that resets on DTR does not reset."""
        attributes = termios.tcgetattr(descriptor)
        if attributes[2] & termios.HUPCL:
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
