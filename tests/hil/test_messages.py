"""Messages about runs: by mail and apprise, to servers on loopback, over a dead network and back."""

import json
import sys
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from quick_runs import THREE, quick_words
from running import called, results
from servers import MailServer, serving

from bench.run.messages.channels import send
from bench.run.messages.outbox import DeliveryFailed, Message
from bench.stations.messages_section import AppriseConfig, MailConfig

MESSAGE = Message(
    "k" * 64, "end", "Starbench: ü finished", "all is well ü\n", "ü", "/runs/ü", "2026-03-01T20:00:00+00:00"
)


def mail_to(server, *to):
    port = server.server_address[1]
    return MailConfig(host="127.0.0.1", port=port, security="none", sender="b@lab.example", to=to)


def test_a_mail_arrives_with_subject_text_and_key():
    with serving(MailServer()) as server:
        send(MESSAGE, mail_to(server, "a@lab.example", "c@lab.example"))
    (letter,) = server.letters
    assert letter["Subject"] == MESSAGE.subject
    assert letter["Message-ID"] == f"<{MESSAGE.key[:40]}@starbench>"
    assert letter["To"] == "a@lab.example, c@lab.example"
    assert letter.get_content().splitlines() == MESSAGE.text.splitlines()


def test_a_mail_about_a_run_that_ended_early_carries_its_page(tmp_path):
    (tmp_path / "report.html").write_text("<p>The refused recording</p>")
    (tmp_path / "report.html.sig").write_text("signature")
    with serving(MailServer()) as server:
        send(replace(MESSAGE, folder=str(tmp_path)), mail_to(server, "a@lab.example"))
    (letter,) = server.letters
    (page,) = letter.iter_attachments()
    assert (page.get_filename(), page.get_content_type()) == ("report.html", "text/html")
    assert "The refused recording" in page.get_content()
    assert letter.get_body().get_content().splitlines() == MESSAGE.text.splitlines()


@pytest.mark.parametrize("to", [("nobody@lab.example",), ("a@lab.example", "nobody@lab.example")])
def test_a_recipient_that_the_server_refuses_is_named(to):
    with serving(MailServer()) as server, pytest.raises(DeliveryFailed, match="nobody"):
        send(MESSAGE, mail_to(server, *to))


def test_a_mail_server_that_is_not_there_is_a_failed_delivery():
    with serving(MailServer()) as server:
        gone = mail_to(server, "a@lab.example")
    with pytest.raises(DeliveryFailed, match="refused"):
        send(MESSAGE, gone)


class Services:
    """Stands for the library apprise: takes what it is told to take."""

    def __init__(self, takes):
        self.takes, self.messages = takes, []

    def Apprise(self):  # noqa: N802 - its name there
        return self

    def add(self, url):
        if "broken" in url:
            raise TypeError(url)
        return url.startswith("json://")

    def notify(self, **words):
        self.messages.append(words)
        return self.takes


CHAT = AppriseConfig(url_env="CHAT")


def test_another_service_gets_subject_and_text(monkeypatch):
    services = Services(takes=True)
    monkeypatch.setitem(sys.modules, "apprise", services)
    send(MESSAGE, CHAT, {"CHAT": "json://127.0.0.1"})
    assert services.messages == [{"title": MESSAGE.subject, "body": MESSAGE.text}]


@pytest.mark.parametrize(
    ("module", "environ", "why"),
    [
        (None, {"CHAT": "json://x"}, "not installed"),
        (Services(takes=True), {}, "CHAT is not set"),
        (Services(takes=True), {"CHAT": "nonsense"}, "is not an address"),
        (Services(takes=False), {"CHAT": "json://u:S3CRET@x"}, "did not accept it"),
        (Services(takes=True), {"CHAT": "broken://u:S3CRET@x"}, "TypeError"),
    ],
)
def test_another_service_that_does_not_take_it_is_a_failed_delivery_and_its_address_stays_secret(
    monkeypatch, module, environ, why
):
    monkeypatch.setitem(sys.modules, "apprise", module)
    with pytest.raises(DeliveryFailed, match=why) as failed:
        send(MESSAGE, CHAT, environ)
    assert "S3CRET" not in str(failed.value)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # apprise loads a module that Python drops
def test_apprise_itself_posts_to_a_webhook_and_prints_no_secret(capfd):
    pytest.importorskip("apprise")
    with serving(ThreadingHTTPServer(("127.0.0.1", 0), Webhook)) as server:
        url = f"json://u:S3CRET@127.0.0.1:{server.server_port}"
        send(MESSAGE, CHAT, {"CHAT": f"{url}/runs"})
        with pytest.raises(DeliveryFailed, match="did not accept"):
            send(MESSAGE, CHAT, {"CHAT": f"{url}/ill"})
    assert (server.post["title"], server.post["message"]) == (MESSAGE.subject, MESSAGE.text.strip())
    assert "S3CRET" not in "".join(capfd.readouterr())


class Webhook(BaseHTTPRequestHandler):
    """Takes what is posted, but for the address ``/ill``."""

    def do_POST(self):
        self.server.post = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(503 if self.path == "/ill" else 200)
        self.end_headers()

    def log_message(self, *_):
        pass


def kept(home):
    return json.loads(called("messages", "--json", home=home).stdout)["messages"]


def test_a_dead_network_holds_up_no_run_and_its_message_goes_out_later(tmp_path):
    home, folder = tmp_path / "home", tmp_path / "run"
    with serving(MailServer()) as server:
        port, section = server.server_address[1], server.section
    ended = called(*quick_words(tmp_path, THREE, station=section), home=home)
    assert "Messages not delivered yet: 1" in ended.stderr
    assert results(folder)["run"]["simulated"]
    with serving(MailServer(port)) as server:
        for _ in range(2):
            called("messages", "--send", home=home)
    (letter,) = server.letters
    assert letter["Subject"] == "Starbench: run run (SIMULATED) finished"
    text = letter.get_content()
    assert "Finished and sealed" in text
    place = results(folder)["run"]["ledger"]
    assert f"Ledger: run 1 of this bench, line {place['head']}" in text
    (sent,) = kept(home)
    assert (sent["state"], sent["perhaps_twice"], sent["message"]["occasion"]) == ("sent", False, "end")
