"""The unchanged GRBL firmware, compiled for this computer, on a pseudo-terminal.

The firmware is free software under the GPL and not part of Starbench. The tests use it if ``STARBENCH_GRBL_SOURCE``
names the folder ``grbl`` of https://github.com/gnea/grbl.
"""

import os
import select
import subprocess
import time
import tty
from collections.abc import Mapping
from pathlib import Path

SOURCE = "STARBENCH_GRBL_SOURCE"
HERE = Path(__file__).parent
STEPS_PER_DEG = 640.0
FACTORY = {22: 1, 24: 600, 25: 2400, 26: 10, 27: 1, **{100 + axis: STEPS_PER_DEG for axis in range(3)}}
"""What is set before a test: homing, its speeds, and the scale; as a user sets a new board."""
FACTORY |= {110 + axis: 2400 for axis in range(3)} | {120 + axis: 200 for axis in range(3)}
FACTORY |= {130: 32, 131: 22, 132: 22}


def compile_board(folder: Path) -> Path:
    """Compile the firmware with the hardware of `board.c`; return the program."""
    program = folder / "board"
    source = Path(os.environ[SOURCE])
    for path in source.glob("*.c"):
        rename = ["-Dmain=grbl_main"] if path.name == "main.c" else []
        flags = [
            "-O0",
            "-w",
            "-std=gnu11",
            "-fsigned-char",
            "-DF_CPU=16000000UL",
            *rename,
            f"-I{HERE / 'stub'}",
        ]
        subprocess.run(["gcc", *flags, "-c", path, "-o", folder / f"{path.stem}.o"], check=True)
    flags = ["-O1", "-Wall", "-Wextra", "-Werror", f"-I{HERE / 'stub'}"]
    subprocess.run(["gcc", *flags, HERE / "board.c", *folder.glob("*.o"), "-lm", "-o", program], check=True)
    return program


class NativeBoard:
    """A board that is powered on, and its wires."""

    def __init__(self, program: Path, eeprom: Path, start_deg: tuple[float, float, float]) -> None:
        self._program, self._eeprom, self._start = program, eeprom, start_deg
        self._firmware_end, self._host_end = os.openpty()
        tty.setraw(self._firmware_end)
        tty.setraw(self._host_end)
        self.port = os.ttyname(self._host_end)
        self.power_on()

    def power_on(self) -> None:
        """Start the firmware; switches and motors stand as they stood."""
        arguments = [str(self._firmware_end), self._eeprom, str(STEPS_PER_DEG), *map(str, self._start)]
        self._process = subprocess.Popen(
            [self._program, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[self._firmware_end],
        )

    def power_off(self) -> None:
        """End the firmware; its memory is kept."""
        x, y, z = self.angles_below()
        self._start = (-x, -y, -z)
        self._end()

    def close(self) -> None:
        """End the firmware, and remove its port."""
        if self._process.returncode is None:
            self._end()
        os.close(self._firmware_end)
        os.close(self._host_end)

    def _end(self) -> None:
        self._process.stdin.close()
        self._process.wait(10)
        self._process.stdout.close()

    def wire(self, word: str, axis: str) -> None:
        """``press`` or ``release`` a switch, ``cut`` or ``mend`` its cable."""
        self._process.stdin.write(f"{word} {axis}\n".encode())
        self._process.stdin.flush()

    def angles_below(self) -> tuple[float, ...]:
        """Return where the axes are, seen from their switches; counted at the motors."""
        self._process.stdin.write(b"where\n")
        self._process.stdin.flush()
        return tuple(map(float, self._process.stdout.readline().split()))

    def say(self, data: bytes | str, quiet_s: float = 0.15, within_s: float = 20.0, until: str = "") -> str:
        """Send bytes as they are; return what comes until the line is quiet for so long, or ``until`` has come."""
        os.write(self._host_end, data.encode("latin-1") if isinstance(data, str) else data)
        answer, deadline_s = b"", time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            if not select.select([self._host_end], [], [], quiet_s if not until else 0.05)[0]:
                if not until:
                    break
                continue
            answer += os.read(self._host_end, 4096)
            if until and until in answer.decode("latin-1"):
                break
        return answer.decode("latin-1")

    def set_up(self, settings: Mapping[int, float] = FACTORY) -> None:
        """Write settings, and cut the power for a moment, so that it begins with them."""
        self.say("", until="help]\r\n")
        self.say("", quiet_s=0.5)  # a new memory is told as an error
        for number, value in settings.items():
            answer = self.say(f"${number}={value:g}\n", until="\r\n")
            assert answer == "ok\r\n", (number, value, answer)
        self.power_off()
        self.power_on()
        self.say("", until="unlock]\r\n")
