"""Who calls by a certificate, over each door: known by a name in it, and let do what its rule says."""

from __future__ import annotations

import datetime
import json
import signal
import ssl
import subprocess

import httpx
import pytest
from percept import Client, PerceptError, Unavailable
from percept import zenoh as by_zenoh

from support import robots, world
from support.pki import DAY, Authority
from support.server import Server, binary, eventually, free_port

RULES = [
    ("cn:robot-7", "write", "fleet-*"),
    ("cn:reader", "read", "fleet-*"),
    ("dns:lift.site.example", "read", "fleet-*"),
    ("uri:spiffe://site/operator", "admin", "*"),
    ("cn:depot", "write", "depot-*"),
]
READS, NOTHING = ("", "PERMISSION_DENIED"), ("SESSION_NOT_FOUND", "SESSION_NOT_FOUND")
#: What becomes of a question and of a change: a reason, empty if it is served.
OUTCOMES = {
    "known by its common name": ("", ""),
    "known by a DNS name": READS,
    "known by a URI": ("", ""),
    "one that may read": READS,
    "one for other sessions": NOTHING,
    "of nobody who is known": ("CREDENTIALS_WITHOUT_GRANT",) * 2,
    "none": ("CREDENTIALS_MISSING",) * 2,
    "of another authority": ("not let in",) * 2,
    "expired": ("not let in",) * 2,
    "not valid yet": ("not let in",) * 2,
    "made for servers": ("not let in",) * 2,
}


class Site:
    """A server that knows its callers by certificates, and certificates of every kind."""

    def __init__(self, folder, *, is_required: bool = False, zenoh: str = "tls", settings: str = "") -> None:
        self.folder, self.ours = folder, Authority(folder / "ours")
        cert, key = self.ours.issue("server", "IP:127.0.0.1")
        rules = "".join(
            f'[[auth.certificates]]\nsubject = "{subject}"\naccess = "{access}"\nsessions = "{sessions}"\n'
            for subject, access, sessions in RULES
        )
        keys = folder / "keys.json"
        made = [binary(), "keys", "create", "--file", keys, "--name", "op", "--scope", "admin", "--json"]
        self.key = json.loads(subprocess.run(made, capture_output=True, check=True).stdout)["key"]
        self.config = folder / "percept.toml"
        self.config.write_text(
            f'[auth]\nmode = "required"\nkeys_file = "{keys}"\n{rules}{settings}'
            f'[tls]\ncert_file = "{cert}"\nkey_file = "{key}"\nclient_ca_file = "{self.ours.ca}"\n'
            f"client_cert_required = {str(is_required).lower()}\n"
        )
        endpoint = zenoh and f"{zenoh}/127.0.0.1:{free_port()}"
        self.server = Server(folder / "data", "--config", str(self.config), zenoh=endpoint)

    def certificates(self) -> dict:
        """Files (certificate, key) by kind; None: no certificate is shown."""
        issue, theirs = self.ours.issue, Authority(self.folder / "theirs")
        return {
            "known by its common name": issue("robot-7"),
            "known by a DNS name": issue("lift", "DNS:LIFT.site.example"),
            "known by a URI": issue("x", "DNS:robot-7,URI:spiffe://site/operator"),
            "one that may read": issue("reader", purpose="client"),
            "one for other sessions": issue("depot"),
            # The names of others, where they do not count.
            "of nobody who is known": issue("lift.site.example", "DNS:robot-7"),
            "none": None,
            "of another authority": theirs.issue("robot-7"),
            "expired": issue("robot-7", valid=(-2 * DAY, -DAY), file="expired"),
            "not valid yet": issue("robot-7", valid=(DAY, 2 * DAY), file="early"),
            "made for servers": issue("robot-7", purpose="server", file="server-robot"),
        }

    def replace(self, old: str, new: str) -> None:
        """Changes the configuration, and has it read again."""
        text = self.config.read_text()
        assert old in text
        self.config.write_text(text.replace(old, new))
        self.server.process.send_signal(signal.SIGHUP)

    def client(self, files, **options) -> Client:
        cert, key = files or (None, None)
        options = {"ca_file": self.ours.ca, "cert_file": cert, "key_file": key, "retries": 0, **options}
        return Client(f"https://{self.server.grpc}", **options)

    def http(self, files, **options) -> httpx.Client:
        context = ssl.create_default_context(cafile=str(self.ours.ca))
        if files:
            context.load_cert_chain(*files)
        return httpx.Client(base_url=f"https://{self.server.rest}", verify=context, timeout=30, **options)

    def peer(self, files, session: str = "fleet-1", **options) -> by_zenoh.MapReader:
        return by_zenoh.MapReader(self.server.zenoh, session_id=session, **self.shown(files), **options)

    def shown(self, files) -> dict:
        cert, key = files or (None, None)
        return {"credentials": by_zenoh.Credentials(ca_file=self.ours.ca, cert_file=cert, key_file=key)}

    def operator(self) -> Client:
        return Client(f"https://{self.server.grpc}", ca_file=self.ours.ca, token=self.key)


@pytest.fixture
def make_site(tmp_path):
    sites = []

    def make(**options) -> Site:
        sites.append(Site(tmp_path, **options))
        return sites[-1]

    yield make
    for site in sites:
        site.server.kill()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site = Site(tmp_path_factory.mktemp("certificates"), zenoh="")
    with site.operator() as operator:
        operator.sessions.create("fleet-1", sensors=[world.LASER])
    yield site
    site.server.kill()


@pytest.fixture(scope="module")
def certificates(site):
    return site.certificates()


def over_grpc(site: Site, files) -> tuple[str, str]:
    def outcome(ask) -> str:
        try:
            ask()
        except PerceptError as error:
            # The client cannot tell more: the server ends the connection in the handshake.
            is_let_in = not (isinstance(error, Unavailable) and error.reason == "SERVER_UNREACHABLE")
            return (error.reason or repr(error)) if is_let_in else "not let in"
        return ""

    with site.client(files, timeout_s=10) as client:
        session = client.session("fleet-1")
        return outcome(session.info), outcome(lambda: session.update(display_name="A"))


def over_rest(site: Site, files) -> tuple[str, str]:
    def outcome(ask) -> str:
        try:
            answer = ask()
        except httpx.TransportError:
            return "not let in"
        return "" if answer.status_code == 200 else answer.json()["reason"]

    with site.http(files) as http:
        at = "/v1/sessions/fleet-1"
        return outcome(lambda: http.get(at)), outcome(lambda: http.patch(at, json={"display_name": "A"}))


@pytest.mark.parametrize("over", [over_grpc, over_rest])
@pytest.mark.parametrize("kind", OUTCOMES)
def test_every_certificate_is_answered_as_the_table_says(site, certificates, kind, over):
    assert over(site, certificates[kind]) == OUTCOMES[kind]


def test_a_key_counts_before_the_certificate(site, certificates):
    files = certificates["of nobody who is known"]
    with site.client(files, token=site.key) as client:
        assert client.session("fleet-1").info()
    forged = {"authorization": f"Bearer {site.key[:-4]}AAAA"}
    with site.http(certificates["known by a URI"], headers=forged) as http:
        assert http.get("/v1/sessions/fleet-1").json()["reason"] == "CREDENTIALS_INVALID"


def test_a_new_authority_holds_for_new_connections_and_old_ones_stay(make_site):
    site = make_site(zenoh="")
    old = site.ours.issue("robot-7")
    with site.operator() as operator:
        operator.sessions.create("fleet-1", sensors=[world.LASER])
    with site.client(old) as grpc, site.http(old) as rest:
        assert grpc.session("fleet-1").info()
        assert rest.get("/v1/sessions/fleet-1").status_code == 200
        site.ours = Authority(site.folder / "ours")
        site.ours.issue("server", "IP:127.0.0.1")
        new = site.ours.issue("robot-7", file="renewed")
        site.server.process.send_signal(signal.SIGHUP)
        assert eventually(lambda: over_rest(site, new) == ("", ""))
        assert over_grpc(site, new) == ("", "")
        assert over_grpc(site, old) == over_rest(site, old) == ("not let in", "not let in")
        assert grpc.session("fleet-1").info()
        assert rest.get("/v1/sessions/fleet-1").status_code == 200


def test_rules_are_read_again_and_who_lost_one_is_not_let_go_on(make_site):
    site = make_site(zenoh="")
    robot, stranger = site.ours.issue("robot-7"), site.ours.issue("robot-8")
    with site.operator() as operator:
        operator.sessions.create("fleet-1", sensors=[world.LASER])
    assert over_grpc(site, robot) == ("", "")
    with site.http(robot) as http, http.stream("GET", "/v1/sessions/fleet-1/events") as events:
        # What cannot be read changes nothing.
        site.replace('"cn:robot-7"', '"robot-7"')
        assert eventually(lambda: "the configuration in force stays" in site.server.tail())
        assert over_rest(site, robot) == ("", "")
        site.replace('"robot-7"', '"cn:robot-8"')
        assert eventually(lambda: over_rest(site, stranger) == ("", ""))
        assert over_grpc(site, robot) == over_rest(site, robot) == ("CREDENTIALS_WITHOUT_GRANT",) * 2
        assert "were revoked" in "".join(events.iter_text())
    # What only a restart brings is said.
    site.replace("[tls]", "[limits]\nmax_sessions = 7\n[tls]")
    assert eventually(lambda: "in force after a restart only" in site.server.tail())


def test_rules_that_are_read_again_hold_for_zenoh(make_site):
    site = make_site(is_required=True)
    robot, stranger, operator_files = site.ours.issue("robot-7"), site.ours.issue("robot-8"), site.ours.issue("op")
    site.replace('"cn:depot"', '"cn:op"')
    site.replace('"depot-*"', '"*"')

    def answers(files) -> bool:
        try:
            with site.peer(files, timeout_s=2.0) as peer:
                return peer.pose().state == "tracking"
        except Unavailable:
            return False

    with Client(
        f"https://{site.server.grpc}", ca_file=site.ours.ca, cert_file=operator_files[0], key_file=operator_files[1]
    ) as operator:
        eventually(lambda: operator.sessions.create("fleet-1", sensors=[world.LASER]))
        with by_zenoh.SensorPublisher(site.server.zenoh, session_id="fleet-1", **site.shown(robot)) as publisher:
            for i in range(3):
                publisher.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
        assert eventually(lambda: len(operator.session("fleet-1").trajectory()) == 3)
    assert answers(robot)
    assert not answers(stranger)
    site.replace('"cn:robot-7"', '"cn:robot-8"')
    assert eventually(lambda: answers(stranger), seconds=30)
    assert not answers(robot)


def test_over_zenoh_a_common_name_counts_where_certificates_are_required(make_site):
    site = make_site(is_required=True)
    certificates = site.certificates()
    operator_files = certificates["known by a URI"]
    with site.client(operator_files) as operator:
        session = operator.sessions.create("fleet-1", sensors=[world.LASER])
        with by_zenoh.SensorPublisher(
            site.server.zenoh, session_id="fleet-1", **site.shown(certificates["known by its common name"])
        ) as robot:
            for i in range(3):
                robot.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
        assert eventually(lambda: len(session.trajectory()) == 3)
        for kind in OUTCOMES:
            files = certificates[kind]
            if "not let in" in OUTCOMES[kind] or files is None:
                with pytest.raises(Unavailable, match="lets us in"):
                    site.peer(files, timeout_s=2.0)
                continue
            with site.peer(files, timeout_s=2.0) as peer:
                if kind in ("known by its common name", "one that may read"):
                    assert peer.pose().state == "tracking"
                else:
                    with pytest.raises(Unavailable, match="nobody answers"):
                        peer.pose()
        # A reader's frames come to nothing.
        with by_zenoh.SensorPublisher(
            site.server.zenoh, session_id="fleet-1", **site.shown(certificates["one that may read"])
        ) as reader:
            reader.send_scan("laser", stamp_ns=world.stamp(9), **robots.scan(9))
        laser = session.sensors.get("laser")
        assert (laser.accepted, laser.rejected) == (3, 0)


def test_a_certificate_that_ends_ends_what_it_was_shown_for(site):
    soon = datetime.timedelta(seconds=3)
    files = site.ours.issue("robot-7", valid=(-DAY, soon), file="short")
    with site.http(files) as http, http.stream("GET", "/v1/sessions/fleet-1/events") as events:
        assert events.status_code == 200
        with site.http(files) as second:
            assert second.get("/v1/sessions/fleet-1").status_code == 200
            assert eventually(lambda: second.get("/v1/sessions/fleet-1").status_code == 401, seconds=15)
        assert "CREDENTIALS_EXPIRED" in "".join(events.iter_text())


def test_certificates_that_zenoh_never_sees_are_told_at_the_start(make_site):
    # Zenoh asks every peer for a certificate or none; with none, nobody whom the rules mean can be known.
    with pytest.raises(AssertionError, match="client_cert_required"):
        make_site(is_required=False)
