"""Knows how a serial port is kept to one program: flock, then TIOCEXCL. Touches nothing but the open port.

Two locks, because neither is enough: flock is advisory, so a program that does not ask walks past it;
TIOCEXCL makes the kernel refuse every further open, but not one by root. Both vanish with the process
that took them, however it ended, so no stale lock can be left behind.
"""

from __future__ import annotations

import contextlib

from drivers import file_lock

try:
    import fcntl
    import termios
except ImportError:  # Windows opens every serial port exclusively by itself.

    def keep_to_ourselves(descriptor: int) -> None:
        """Nothing to do: the system has locked the port at opening."""

    def let_others_in(descriptor: int) -> None:
        """Nothing to do: the system unlocks the port at closing."""

    def keep_lines_up_after_closing(descriptor: int) -> None:
        """Nothing to do: the system has no such setting."""

else:

    def keep_to_ourselves(descriptor: int) -> None:
        """Lock an open port; raises BlockingIOError when another program has it locked.

        A second flock of the same descriptor does no harm.

        Parameters
        ----------
        descriptor
            File descriptor of the open port.
        """
        file_lock.lock(descriptor)
        # A device that is no terminal has no TIOCEXCL; flock holds all the same.
        with contextlib.suppress(OSError):
            fcntl.ioctl(descriptor, termios.TIOCEXCL)

    def let_others_in(descriptor: int) -> None:
        """Give the kernel's lock back: it sticks to the terminal, not to the descriptor."""
        with contextlib.suppress(OSError):
            fcntl.ioctl(descriptor, termios.TIOCNXCL)

    def keep_lines_up_after_closing(descriptor: int) -> None:
        """Clear HUPCL: closing then leaves DTR alone, and a board that resets on DTR does not reset.

        Raises termios.error when the port has gone.
        """
        attributes = termios.tcgetattr(descriptor)
        if attributes[2] & termios.HUPCL:
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
