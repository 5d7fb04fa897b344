"""A mail server on loopback that keeps the letters that it is sent."""

import socketserver
import threading
from contextlib import contextmanager
from email import message_from_bytes, policy


class MailServer(socketserver.ThreadingTCPServer):
    """Speaks as much SMTP as takes a letter; refuses recipients named ``nobody``; takes none while it is ``busy``."""

    allow_reuse_address = daemon_threads = True

    def __init__(self, port=0):
        self.letters, self.busy, self.offered = [], False, threading.Event()
        super().__init__(("127.0.0.1", port), _MailSession)

    @property
    def section(self):
        """The section of a station file that sends messages here."""
        mail = f"host: 127.0.0.1, port: {self.server_address[1]}, security: none"
        return f"\nmessages: {{mail: {{{mail}, sender: b@lab.example, to: [a@lab.example]}}}}\n"

    @property
    def subjects(self):
        return [letter["Subject"] for letter in self.letters]


class _MailSession(socketserver.StreamRequestHandler):
    def handle(self):
        self.say("220 test")
        while line := self.rfile.readline():
            word = line.strip().upper()
            if word.startswith((b"EHLO", b"HELO")):
                self.say("250 test")
            elif word.startswith(b"RCPT") and b"NOBODY" in word:
                self.say("550 no such user")
            elif word == b"DATA":
                self.say("354 go on")
                self.take()
            elif word == b"QUIT":
                self.say("221 bye")
                return
            else:
                self.say("250 ok")

    def take(self):
        lines = []
        while (line := self.rfile.readline()) != b".\r\n":
            lines.append(line)
        self.server.offered.set()
        if self.server.busy:
            self.rfile.read()  # until the client is gone
            return
        self.server.letters.append(message_from_bytes(b"".join(lines), policy=policy.default))
        self.say("250 taken")

    def say(self, text):
        self.wfile.write(text.encode() + b"\r\n")


@contextmanager
def serving(server):
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
