"""A model of a Gardasoft RT controller in memory: two channels and an internal trigger."""

from __future__ import annotations

import re

from tests.unit.drivers.peer_port import PeerPort


class RtPeer(PeerPort):
    """`spoil` may change a reply, prompt included. `lit` notes whether the lamp was ever driven."""

    name = "strobe"

    def __init__(self) -> None:
        super().__init__()
        self.running = 0
        self.period_ms = 20.0
        self.channels = {n: {"MD": 0, "S": 0.0, "DL": 0.0, "PU": 1.0} for n in (1, 2)}
        self.shortest_ms = 5.0
        self.event = ""
        self.lit = False

    def write(self, data: bytes) -> None:
        assert data.endswith(b"\r")
        command = data[:-1].decode("latin-1")
        self.sent.append(command)
        answer = self.serve(command)
        self.ready += self.spoil((f"{answer}\r\n>" if answer else ">").encode())
        channel = self.channels[1]
        self.lit |= bool(channel["S"] and (self.running or channel["MD"] == 0))

    def serve(self, command: str) -> str:
        if command == "VR":
            return "RT260-20 (HW02) V031"
        if command == "GR":
            event, self.event = self.event, ""
            return event
        if command == "ST0":
            return f"TM {self.running}, TP {self.period_ms:.2f}ms"
        if match := re.fullmatch(r"ST([12])", command):
            channel = self.channels[int(match[1])]
            level, delay, pulse = f"{channel['S']:.1f}%", channel["DL"], channel["PU"]
            return (
                f"CH {match[1]}, MD {channel['MD']}, S {level},{level}, DL {delay:.2f}ms, PU {pulse:.3f}ms,"
                " RT 0.000us, IP 1, FL 0, CS 1.000A, RA 1.000A"
            )
        if match := re.fullmatch(r"TT([01])(?:,(\d+\.\d+))?", command):
            self.running = int(match[1])
            if match[2]:
                return self.trigger(float(match[2]))
            return ""
        if match := re.fullmatch(r"RS([12]),(\d+(?:\.\d+)?)", command):
            self.channels[int(match[1])].update(MD=0, S=float(match[2]))
            return ""
        if match := re.fullmatch(r"RT([12]),(\d+\.\d+),(0\.\d+),(\d+\.\d+)", command):
            if float(match[4]) > 200.0:
                return "Err 1"
            self.channels[int(match[1])].update(
                MD=2, PU=float(match[2]), DL=float(match[3]), S=float(match[4])
            )
            return ""
        return "Err 2"

    def trigger(self, period_ms: float) -> str:
        self.period_ms = max(period_ms, self.shortest_ms)
        return "Err 5" if period_ms < self.shortest_ms else ""
