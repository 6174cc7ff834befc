"""Tokens of an identity provider: found by discovery over https, its keys changed, taken away, forged."""

from __future__ import annotations

import base64
import json
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from percept import Client, PerceptError

from support.pki import Authority
from support.provider import DISCOVERY, KEYS, Key, Provider, base64url
from support.server import Server, binary, eventually

#: Keys are fetched ten seconds apart at most.
FETCHED_S = 30.0
UNAVAILABLE, INVALID = "IDENTITY_PROVIDER_UNAVAILABLE", "CREDENTIALS_INVALID"


class Site:
    """A server that takes the tokens of a provider, whose certificate is of an authority of its own."""

    def __init__(self, folder, *, keys: bool = False, ca_file: object = None, **jwt: object) -> None:
        self._keys = folder / "keys.json"
        self.authority = Authority(folder / "pki")
        self.provider = Provider(self.authority.issue("provider", "IP:127.0.0.1"))
        settings = {"issuer": self.provider.issuer, "ca_file": str(ca_file or self.authority.ca), **jwt}
        config = folder / "percept.toml"
        lines = "".join(f"{name} = {json.dumps(value)}\n" for name, value in settings.items())
        known = f'keys_file = "{self._keys}"\n' if keys else ""
        names = ("one", "two") if keys else ()
        self.keys = {name: self._key("create", "--name", name, "--scope", "admin") for name in names}
        config.write_text(f'[auth]\nmode = "required"\n{known}[auth.jwt]\n{lines}')
        self.server = Server(folder / "data", "--config", str(config), zenoh="")

    def asked(self, token: str) -> str:
        """The reason for which a list over REST is refused; empty if it is served."""
        headers = {"authorization": f"Bearer {token}"}
        answer = httpx.get(f"{self.server.rest_url}/v1/sessions", headers=headers, timeout=30)
        if answer.status_code == 200:
            return ""
        reason = answer.json()["reason"]
        assert answer.status_code == (503 if reason == UNAVAILABLE else 401), answer.text
        return reason

    def asked_by_grpc(self, token: str) -> str:
        with Client(self.server.grpc, token=token, retries=0) as client:
            try:
                list(client.sessions.list())
            except PerceptError as error:
                return error.reason
            return ""

    def revoke(self, name: str) -> None:
        """Takes a key back."""
        self._key("revoke", name)

    def _key(self, verb: str, *arguments: str) -> str:
        command = [binary(), "keys", verb, "--file", self._keys, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    def close(self) -> None:
        self.server.kill()
        self.provider.stop()


@pytest.fixture
def make_site(tmp_path):
    sites = []

    def make(**options) -> Site:
        sites.append(Site(tmp_path, **options))
        return sites[-1]

    yield make
    for site in sites:
        site.close()


def test_tokens_are_checked_with_keys_that_discovery_finds(make_site):
    site = make_site()
    token = site.provider.token()
    assert site.asked(token) == site.asked_by_grpc(token) == ""
    # Once for all tokens.
    assert site.provider.asked == [DISCOVERY, KEYS]
    with Client(site.server.grpc, token=token) as robot:
        assert robot.sessions.create("fleet-1").info()
    reader = site.provider.token(scope="percept:read")
    with Client(site.server.grpc, token=reader) as robot, pytest.raises(PerceptError) as refused:
        robot.session("fleet-1").update(display_name="A")
    assert refused.value.reason == "PERMISSION_DENIED"


def test_forged_tokens_are_refused(make_site):
    site = make_site()
    issuer, key = site.provider.token, site.provider.keys[0]
    assert site.asked(issuer()) == ""
    stranger = Key(key.kid)
    header, payload, signature = issuer().split(".")
    unsigned = base64url(json.dumps({"alg": "none"}).encode())
    admin = base64url(base64.urlsafe_b64decode(payload + "==").replace(b"percept:write", b"percept:admin"))
    served = site.provider.issuer + "/theirs"
    site.provider.pages["/theirs"] = {"keys": [stranger.public()]}
    for forged in (
        issuer(key=stranger),
        issuer(key=Key("unknown")),
        issuer(key=stranger, header={"jku": served}),
        issuer(key=stranger, header={"jwk": stranger.public()}),
        issuer(header={"alg": "HS256"}),
        issuer(header={"crit": ["exp"]}),
        issuer(iss="https://127.0.0.1:1"),
        issuer(aud="another"),
        f"{header}.{admin}.{signature}",
        f"{unsigned}.{payload}.",
        f"{header}.{payload}.",
        f"{header}.{payload}.{'A' * 86}",
    ):
        assert site.asked(forged) == site.asked_by_grpc(forged) == INVALID, forged
    assert "/theirs" not in site.provider.asked


def test_a_key_that_is_new_is_taken_and_one_that_is_gone_is_not(make_site):
    site = make_site()
    first = site.provider.keys[0]
    assert site.asked(site.provider.token()) == ""
    site.provider.keys = [Key("second")]
    assert eventually(lambda: site.asked(site.provider.token()) == "", seconds=FETCHED_S)
    assert site.asked(site.provider.token(key=first)) == INVALID


def test_a_provider_that_is_away_at_the_start_is_asked_again(make_site, tmp_path):
    site = make_site()
    token = site.provider.token()
    site.provider.stop()
    assert site.asked(token) == site.asked_by_grpc(token) == UNAVAILABLE
    site.provider.start()
    assert eventually(lambda: site.asked(token) == "", seconds=FETCHED_S)
    # What was known holds while it is away again.
    site.provider.stop()
    assert site.asked(site.provider.token()) == ""
    assert site.asked(site.provider.token(key=Key("unknown"))) == INVALID


@pytest.mark.parametrize(
    ("described", "told"),
    [
        ({"issuer": "https://127.0.0.1:1"}, "of the issuer"),
        ({"jwks_uri": "http://127.0.0.1:1/keys"}, "not protected"),
        ({"jwks_uri": "file:///etc/passwd"}, "not protected"),
    ],
)
def test_a_provider_that_describes_itself_wrongly_is_not_believed(make_site, described, told):
    site = make_site()
    site.provider.pages[DISCOVERY] = site.provider.described(**described)
    assert site.asked(site.provider.token()) == UNAVAILABLE
    assert told in site.server.tail()
    assert KEYS not in site.provider.asked


def test_a_provider_of_another_authority_is_not_believed(make_site, tmp_path):
    site = make_site(ca_file=Authority(tmp_path / "other").ca)
    assert site.asked(site.provider.token()) == UNAVAILABLE
    assert "certificate" in site.server.tail().lower()
    assert site.provider.asked == []


def test_a_token_that_ends_ends_the_watch(make_site):
    site = make_site(leeway_s=0)
    with Client(site.server.grpc, token=site.provider.token()) as robot:
        robot.sessions.create("fleet-1")
    soon = site.provider.token(exp=int(time.time()) + 3)
    headers = {"authorization": f"Bearer {soon}"}
    with httpx.stream(
        "GET", f"{site.server.rest_url}/v1/sessions/fleet-1/events", headers=headers, timeout=30
    ) as events:
        assert events.status_code == 200
        assert "CREDENTIALS_EXPIRED" in "".join(events.iter_text())
    assert site.asked(soon) == "CREDENTIALS_EXPIRED"


def test_a_provider_that_does_not_answer_holds_nobody_else_up(make_site):
    site = make_site(keys=True)
    token, answers = site.provider.token(), threading.Event()
    assert site.asked(token) == site.asked(site.keys["one"]) == ""
    site.provider.pages[DISCOVERY] = answers.wait

    def held_up() -> bool:
        unknown = site.provider.token(key=Key("unknown"))
        asking.append(pool.submit(site.asked, unknown))
        return eventually(lambda: site.provider.asked.count(DISCOVERY) > 1, seconds=1)

    asking = []
    with ThreadPoolExecutor(8) as pool:
        # Asked again only some time after the last.
        assert eventually(held_up, seconds=FETCHED_S)
        assert site.asked(token) == site.asked_by_grpc(token) == ""
        for name, key in site.keys.items():
            site.revoke(name)
            assert eventually(lambda key=key: site.asked(key) == "CREDENTIALS_REVOKED")
        assert not asking[-1].done(), "a key that was revoked held until the provider was given up"
        answers.set()
