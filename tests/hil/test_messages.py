"""Messages about runs: by mail and webhook, to servers on loopback, over a dead network and back."""

import json
import sys
from dataclasses import replace

import pytest
from quick_runs import THREE, write_sequence, write_station
from running import called, results
from servers import MailServer, WebServer, serving

from bench.batch.messages import DeliveryFailed, Message, channels_of, send
from bench.stations.messages_section import AppriseConfig, MailConfig, MessagesConfig, WebhookConfig

MESSAGE = Message(
    "k" * 64,
    "end",
    "Starbench: run ü finished",
    "all is well ü\n",
    "ü",
    "/runs/ü",
    "2026-03-01T20:00:00+00:00",
)


def mail_to(server, *to):
    mail = MailConfig(
        host="127.0.0.1", port=server.server_address[1], security="none", sender="b@lab.example", to=to
    )
    (channel,) = channels_of(MessagesConfig(mail=mail))
    return channel


def hook_to(**words):
    (channel,) = channels_of(MessagesConfig(webhooks=[WebhookConfig(**words)]))
    return channel


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


def test_a_webhook_gets_one_object_with_its_key():
    with serving(WebServer()) as server:
        send(MESSAGE, hook_to(url_env="SECRET"), {"SECRET": server.url})
    ((key, post),) = server.posts
    assert key == post["id"] == MESSAGE.key
    assert set(post) == {
        "schema", "id", "occasion", "subject", "text", "run", "folder", "utc", "ledger_number", "ledger_head",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("environ", "why"),
    [
        ({}, "SECRET is not set"),
        ({"SECRET": "file:///etc/passwd"}, "is not an http"),
        ({"SECRET": "http://127.0.0.1:1/"}, "refused"),
    ],
)
def test_an_address_that_leads_nowhere_is_a_failed_delivery(environ, why):
    with pytest.raises(DeliveryFailed, match=why):
        send(MESSAGE, hook_to(url_env="SECRET"), environ)


def test_a_server_that_is_ill_is_a_failed_delivery():
    with serving(WebServer()) as server:
        server.status = 503
        with pytest.raises(DeliveryFailed, match="503"):
            send(MESSAGE, hook_to(url=server.url))


@pytest.mark.parametrize("status", [300, 301, 302, 303, 307, 308])
def test_a_server_that_redirects_has_not_taken_the_message_and_gets_no_other_request(status):
    with serving(WebServer()) as server:
        server.status, server.location = status, "/elsewhere"
        with pytest.raises(DeliveryFailed, match=str(status)):
            send(MESSAGE, hook_to(url=server.url))
    assert len(server.posts) == 1
    assert server.gets == []


class Services:
    """Stands for the library apprise: takes what it is told to take."""

    def __init__(self, takes):
        self.takes, self.messages = takes, []

    def Apprise(self):  # noqa: N802 - its name there
        return self

    def add(self, url):
        return url.startswith("json://")

    def notify(self, **words):
        self.messages.append(words)
        return self.takes


def by_apprise():
    (channel,) = channels_of(MessagesConfig(apprise=[AppriseConfig(url_env="CHAT")]))
    return channel


def test_another_service_gets_subject_and_text(monkeypatch):
    services = Services(takes=True)
    monkeypatch.setitem(sys.modules, "apprise", services)
    send(MESSAGE, by_apprise(), {"CHAT": "json://127.0.0.1"})
    assert services.messages == [{"title": MESSAGE.subject, "body": MESSAGE.text}]


@pytest.mark.parametrize(
    ("module", "environ", "why"),
    [
        (None, {"CHAT": "json://x"}, "not installed"),
        (Services(takes=True), {}, "CHAT is not set"),
        (Services(takes=True), {"CHAT": "nonsense"}, "is not an address"),
        (Services(takes=False), {"CHAT": "json://x"}, "did not accept it"),
    ],
)
def test_another_service_that_does_not_take_it_is_a_failed_delivery(monkeypatch, module, environ, why):
    monkeypatch.setitem(sys.modules, "apprise", module)
    with pytest.raises(DeliveryFailed, match=why):
        send(MESSAGE, by_apprise(), environ)


def test_a_dead_network_holds_up_no_run_and_its_message_goes_out_later(tmp_path):
    home, folder = tmp_path / "home", tmp_path / "run"
    sequence = write_sequence(tmp_path / "sequence.yaml", THREE)
    with serving(WebServer()) as server:
        port, url = server.server_port, server.url
    station = write_station(tmp_path / "station.yaml", f"\nmessages: {{webhooks: [{{url: '{url}'}}]}}\n")
    ended = called("run", sequence, "-s", station, "--seed", 7, "-o", folder, home=home)
    assert ended.returncode == 0, ended.stderr
    assert "Messages not delivered yet: 1" in ended.stderr
    assert results(folder)["run"]["simulated"]
    with serving(WebServer(port)) as server:
        for _ in range(2):
            assert called("messages", "--send", home=home).returncode == 0
    ((_, post),) = server.posts
    assert post["occasion"] == "end"
    assert post["subject"] == "Starbench: run run (SIMULATED) finished"
    assert "Finished and sealed" in post["text"]
    place = results(folder)["run"]["ledger"]
    assert (post["ledger_number"], post["ledger_head"]) == (1, place["head"])
    assert f"Ledger: run 1 of this bench, line {place['head']}" in post["text"]
    (kept,) = json.loads(called("messages", "--json", home=home).stdout)["messages"]
    assert (kept["state"], kept["perhaps_twice"]) == ("sent", False)
