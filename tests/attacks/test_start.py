"""What an operator is told before a server listens and while its files change: settings that cannot be meant, keys and
certificates that will not do, and who else may read what is written."""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess

import httpx
import pytest
from percept import Client, Unauthenticated

from support.pki import DAY, Authority
from support.prometheus import Metrics, read
from support.server import Server, binary, eventually, free_port

CLOSED = '[listen]\ngrpc = "127.0.0.1:0"\nrest = "127.0.0.1:0"\nzenoh = ""\n'
REQUIRED = '[auth]\nmode = "required"\n'
EXPIRY = "percept_tls_certificate_expiry_timestamp_seconds"


@pytest.fixture
def start(tmp_path):
    """Starts a server with a configuration file of this text."""
    servers = []

    def start(text: str, **options) -> Server:
        config = tmp_path / "percept.toml"
        config.write_text(text)
        servers.append(Server(tmp_path / "started", "--config", str(config), **{"zenoh": "", **options}))
        return servers[-1]

    yield start
    for server in servers:
        server.kill()


@pytest.fixture
def authority(tmp_path):
    return Authority(tmp_path / "pki")


def run(*command, **options) -> subprocess.CompletedProcess:
    return subprocess.run([binary(), *command], capture_output=True, text=True, timeout=30, check=False, **options)


def key(file) -> str:
    made = run("keys", "create", "--file", file, "--name", "op", "--scope", "admin", "--json")
    return json.loads(made.stdout)["key"]


def secured(files) -> str:
    return f'[tls]\ncert_file = "{files[0]}"\nkey_file = "{files[1]}"\n'


# Before it listens


UNUSABLE = {
    "no file of keys": (CLOSED, 'keys_file = "absent.json"\n', "auth.keys_file: "),
    "no file of the provider's keys": (
        CLOSED,
        '[auth.jwt]\nissuer = "https://id"\njwks_file = "absent.json"\n',
        "auth.jwt.jwks_file is absent.json, which cannot be used: ",
    ),
    "a provider's keys that are none": (
        CLOSED,
        '[auth.jwt]\nissuer = "https://id"\njwks_file = "percept.toml"\n',
        "auth.jwt.jwks_file is percept.toml, which cannot be used: the keys are no JWKS",
    ),
    "zenoh, where nobody could be known": (
        CLOSED.replace('zenoh = ""', 'zenoh = "tcp/127.0.0.1:{port}"'),
        'keys_file = "keys.json"\n',
        "auth.zenoh_users",
    ),
    "no file of zenoh's users": (
        CLOSED.replace('zenoh = ""', 'zenoh = "tcp/127.0.0.1:{port}"'),
        'zenoh_users_file = "absent"\n[[auth.zenoh_users]]\nuser = "a"\naccess = "read"\n',
        "auth.zenoh_users_file is absent, which cannot be read: ",
    ),
    "no certificate": (
        CLOSED,
        'keys_file = "keys.json"\n[tls]\ncert_file = "absent.pem"\nkey_file = "absent.key"\n',
        "tls.cert_file is absent.pem, which cannot be used: ",
    ),
    "rules for certificates that no client is asked for": (
        CLOSED,
        'keys_file = "keys.json"\n[[auth.certificates]]\nsubject = "cn:robot-7"\naccess = "write"\n',
        "set tls.client_ca_file",
    ),
    "metrics for everybody": (
        CLOSED,
        'keys_file = "keys.json"\n[telemetry]\nlisten = "0.0.0.0:0"\n',
        "set auth.open_metrics = true",
    ),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_the_check_of_a_configuration_refuses_what_the_server_refuses(tmp_path, case):
    listen, rest, told = UNUSABLE[case]
    key(tmp_path / "keys.json")
    (tmp_path / "percept.toml").write_text(listen.replace("{port}", str(free_port())) + REQUIRED + rest)
    served = run("serve", "--config", "percept.toml", "--data-dir", "data", cwd=tmp_path)
    checked = run("config", "--check", "percept.toml", cwd=tmp_path)
    assert (served.returncode, checked.returncode) == (1, 1), checked.stdout
    assert told in served.stderr
    assert checked.stderr.splitlines()[-1] == served.stderr.splitlines()[-1]
    assert not (tmp_path / "data").exists(), "what is refused leaves nothing behind"


def test_the_server_and_its_health_check_share_an_environment(start, authority, monkeypatch):
    monkeypatch.setenv("PERCEPT_CA_FILE", str(authority.ca))
    monkeypatch.setenv("PERCEPT_SERVER", "https://127.0.0.1:1")
    server = start(secured(authority.issue("server", "IP:127.0.0.1")))
    monkeypatch.setenv("PERCEPT_SERVER", f"https://{server.grpc}")
    assert run("health").stdout == "serving\n"


def test_metrics_that_are_open_by_intent_are_served_apart_without_a_key(start, tmp_path):
    key(tmp_path / "keys.json")
    known = f'{REQUIRED}keys_file = "{tmp_path / "keys.json"}"\nopen_metrics = true\n'
    server = start(f'{known}[telemetry]\nlisten = "0.0.0.0:0"\n')
    port = server.doors["telemetry"].rsplit(":", 1)[1]
    assert Metrics(f"http://127.0.0.1:{port}").sum("percept_ready") == 1
    assert httpx.get(f"{server.rest_url}/metrics").status_code in (401, 404)


@pytest.mark.parametrize("is_secured", [False, True])
def test_keys_that_would_travel_readably_are_warned_of(start, authority, tmp_path, is_secured):
    key(tmp_path / "keys.json")
    tls = secured(authority.issue("server", "IP:127.0.0.1")) if is_secured else ""
    server = start(f'{REQUIRED}keys_file = "{tmp_path / "keys.json"}"\n{tls}', grpc="0.0.0.0:0")
    warned = [line for line in server.log.read_text().splitlines() if "travel readably" in line]
    assert len(warned) == (0 if is_secured else 1), server.tail()
    assert all("WARN" in line and "listen.grpc" in line and "tls.cert_file" in line for line in warned)


# Certificates


@pytest.mark.parametrize(
    ("valid", "told"), [((-2 * DAY, -DAY), "has expired"), ((DAY, 2 * DAY), "is not valid yet")], ids=["old", "early"]
)
def test_a_certificate_that_does_not_hold_is_warned_of_at_the_start_and_when_it_comes(start, authority, valid, told):
    files = authority.issue("bad", "IP:127.0.0.1", valid=valid)
    server = start(secured(files))

    def warnings() -> list[str]:
        return [line for line in server.log.read_text().splitlines() if "WARN" in line and told in line]

    assert len(warnings()) == 1 and "CN=bad" in warnings()[0], server.tail()
    authority.issue("good", "IP:127.0.0.1", file="bad")
    server.process.send_signal(signal.SIGHUP)
    assert eventually(lambda: re.search(r"INFO .*in force.*CN=good", server.log.read_text())), server.tail()
    authority.issue("worse", "IP:127.0.0.1", valid=valid, file="bad")
    server.process.send_signal(signal.SIGHUP)
    assert eventually(lambda: len(warnings()) == 2), server.tail()
    assert "CN=worse" in warnings()[1]


def test_metrics_tell_when_the_certificate_ends(start, authority):
    server = start(secured(authority.issue("server", "IP:127.0.0.1", valid=(-DAY, 30 * DAY))))
    series = read(httpx.get(f"https://{server.rest}/metrics", verify=False).text)
    at_s, now_s = series[EXPIRY, frozenset()], series["process_start_time_seconds", frozenset()]
    assert 29.9 < (at_s - now_s) / 86400 < 30.1


def test_without_tls_no_metric_tells_of_a_certificate(server):
    assert (EXPIRY, frozenset()) not in Metrics(server.rest_url).series


# The tools


def test_tools_say_what_to_do_where_one_side_speaks_tls_and_the_other_does_not(start, authority, own_server):
    server = start(secured(authority.issue("server", "IP:127.0.0.1")))
    plain = run("health", "--server", f"http://{server.grpc}").stderr
    assert "https://" in plain and "code:" not in plain, plain
    drive = run("sim", "--server", server.grpc, "--duration-s", "1", "--rooms", "1").stderr
    assert "https://" in drive and "code:" not in drive, drive
    unknown = run("health", "--server", f"https://{server.grpc}").stderr
    assert "--ca-file" in unknown, unknown
    secure = run("health", "--server", f"https://{own_server.grpc}", "--ca-file", authority.ca).stderr
    assert "write http://" in secure, secure


def test_the_hint_how_to_revoke_a_new_key_works_as_it_is_written(tmp_path):
    file = tmp_path / "keys.json"
    made = run("keys", "create", "--file", file, "--name", "op", "--scope", "read")
    hint = re.search(r"`percept (.*)`", made.stderr)[1]
    revoked = run(*shlex.split(hint))
    assert (revoked.returncode, revoked.stderr) == (0, "")
    assert "revoked" in run("keys", "list", "--file", file).stdout


# While it runs


def test_what_a_changed_configuration_brings_is_told(start, tmp_path):
    server = start("")
    (tmp_path / "percept.toml").write_text('[log]\nlevel = "percept=debug,info"\n[quotas.each]\nweight = 2\n')
    server.process.send_signal(signal.SIGHUP)
    told = r'INFO .*the configuration was read again.*taken="quotas, log.level"'
    assert eventually(lambda: re.search(told, server.log.read_text())), server.tail()


def test_a_provider_file_that_is_broken_is_told_once(start, tmp_path):
    file, jwks = tmp_path / "keys.json", tmp_path / "jwks.json"
    key(file)
    point = {"kty": "OKP", "crv": "Ed25519", "kid": "a", "x": "11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo"}
    jwks.write_text(json.dumps({"keys": [point]}))
    provider = f'[auth.jwt]\nissuer = "https://id"\njwks_file = "{jwks}"\n'
    server = start(f'{REQUIRED}keys_file = "{file}"\n{provider}')
    jwks.write_text("broken")

    def is_known(token: str) -> bool:
        with Client(server.grpc, token=token, retries=0) as client:
            try:
                return list(client.sessions.list()) == []
            except Unauthenticated:
                return False

    # Both files are looked at once a second: new keys that are known one after the other tell the rounds.
    for _ in range(4):
        made = key(file)
        assert eventually(lambda made=made: is_known(made))
    assert server.log.read_text().count("auth.jwt.jwks_file is not taken") == 1, server.tail()


# What others on the machine may read


def test_new_data_and_exports_are_their_owners_alone(own_server, tmp_path):
    assert own_server.data_dir.stat().st_mode & 0o777 == 0o700
    with Client(own_server.grpc) as client:
        client.sessions.create("robot-7")
    for verb, to in (("export", "out.percept"), ("backup", "copy")):
        done = run("store", verb, "--data-dir", own_server.data_dir, tmp_path / to)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / to).stat().st_mode & 0o077 == 0, to
