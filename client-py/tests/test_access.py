"""Addresses, TLS, tokens: who asks whom over what."""

import asyncio
import os

import grpc
import pytest
from conftest import FakeServer, refuse

from percept import AsyncClient, Client, InvalidArgument, Unauthenticated, Unavailable
from percept import _rpc as rpc

trustme = pytest.importorskip("trustme")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """An authority, what a server and a client of it have, and another authority."""
    folder = tmp_path_factory.mktemp("tls")
    authority = trustme.CA()
    authority.cert_pem.write_to_path(folder / "ca.pem")
    trustme.CA().cert_pem.write_to_path(folder / "other.pem")
    for name, identity in (("server", "127.0.0.1"), ("robot", "robot"), ("tunnel", "percept.example")):
        issued = authority.issue_cert(identity)
        issued.private_key_pem.write_to_path(folder / f"{name}.key")
        issued.cert_chain_pems[0].write_to_path(folder / f"{name}.pem")
    return folder


def tls_server(files, name="server", ask_for_certificate=False):
    pair = ((files / f"{name}.key").read_bytes(), (files / f"{name}.pem").read_bytes())
    server = FakeServer(
        grpc.ssl_server_credentials(
            [pair],
            root_certificates=(files / "ca.pem").read_bytes() if ask_for_certificate else None,
            require_client_auth=ask_for_certificate,
        )
    )
    server.unary(rpc.GET_POSE, lambda *_: rpc.GET_POSE.answer())
    return server


@pytest.fixture
def secure(files):
    server = tls_server(files)
    yield server
    server.stop()


@pytest.mark.parametrize("form", ["https://{}", "grpcs://{}/", "{}"])
def test_tls_is_asked_for_by_the_address_or_by_a_file(secure, files, form):
    with Client(form.format(secure.address), ca_file=files / "ca.pem", token="t") as client:
        assert client.session("s").pose() is None
    assert secure.headers[0]["authorization"] == "Bearer t"


def test_an_authority_that_is_not_trusted_is_not_talked_to(secure, files):
    for options in ({"ca_file": files / "other.pem"}, {"tls": True}):
        with Client(secure.address, retries=0, **options) as client, pytest.raises(Unavailable):
            client.session("s").pose()
    assert secure.calls == []


def test_a_client_shows_its_certificate(files):
    server = tls_server(files, ask_for_certificate=True)
    try:
        options = {"ca_file": files / "ca.pem", "retries": 0}
        with Client(server.address, **options) as client, pytest.raises(Unavailable):
            client.session("s").pose()
        known = {"cert_file": files / "robot.pem", "key_file": files / "robot.key"}
        with Client(server.address, ca_file=files / "ca.pem", **known) as client:
            assert client.session("s").pose() is None
    finally:
        server.stop()


def test_a_certificate_made_out_to_another_name_is_accepted_by_that_name(files):
    server = tls_server(files, "tunnel")
    try:
        options = {"ca_file": files / "ca.pem", "retries": 0}
        with Client(server.address, **options) as client, pytest.raises(Unavailable):
            client.session("s").pose()
        with Client(server.address, server_name="percept.example", **options) as client:
            assert client.session("s").pose() is None
    finally:
        server.stop()


def test_asyncio_does_the_same(secure, files):
    async def scenario():
        async with AsyncClient(f"https://{secure.address}", ca_file=files / "ca.pem", token="t") as client:
            return await client.session("s").pose()

    assert asyncio.run(scenario()) is None
    assert secure.headers[0]["authorization"] == "Bearer t"


def test_a_token_file_is_read_again_when_it_changed(fake, tmp_path):
    fake.unary(rpc.GET_POSE, lambda *_: rpc.GET_POSE.answer())
    file = tmp_path / "token"
    file.write_text("first\n")
    with Client(fake.address, token_file=file) as client:
        session = client.session("s")
        session.pose()
        # As secrets are replaced: a new file in the place of the old one.
        (tmp_path / "next").write_text("second\n")
        os.replace(tmp_path / "next", file)
        session.pose()
        # Half-way through there may be none, or an empty one.
        file.write_text("")
        session.pose()
        file.unlink()
        session.pose()
    sent = [h["authorization"] for h in fake.headers]
    assert sent == ["Bearer first", "Bearer second", "Bearer second", "Bearer second"]


def test_a_wrong_token_is_unauthenticated_and_not_tried_again(fake):
    code = grpc.StatusCode.UNAUTHENTICATED
    fake.unary(rpc.GET_POSE, lambda _, c: refuse(c, code, "TOKEN_EXPIRED", "authorization"))
    with Client(fake.address, token="old") as client, pytest.raises(Unauthenticated) as error:
        client.session("s").pose()
    assert error.value.reason == "TOKEN_EXPIRED"
    assert len(fake.calls) == 1


@pytest.mark.parametrize(
    "address",
    [
        "localhost:1",
        "127.0.0.1",
        "127.1.2.3:1",
        "[::1]:1",
        "::1",
        "unix:/run/percept",
        "http://localhost",
        "dns:///localhost:1",
    ],
)
def test_a_token_may_travel_readably_on_this_machine(address):
    Client(address, token="t").close()


@pytest.mark.parametrize(
    "address",
    ["percept:50051", "10.0.0.1:1", "http://percept", "dns:///percept:1", "localhost.example:1", "[::2]:1"],
)
def test_a_token_does_not_travel_readably_to_another_machine_unasked(address):
    with pytest.raises(InvalidArgument) as error:
        Client(address, token="t")
    assert (error.value.reason, error.value.field) == ("TOKEN_UNPROTECTED", "address")
    Client(address, token="t", allow_insecure_token=True).close()
    if "://" not in address:
        Client(f"https://{address}", token="t").close()


@pytest.mark.parametrize(
    ("options", "reason", "field"),
    [
        ({"token": "a", "token_file": "b"}, "OPTIONS_CONFLICT", "token_file"),
        ({"token": "  "}, "TOKEN_INVALID", "token"),
        ({"token": "two words"}, "TOKEN_INVALID", "token"),
        ({"token": "a\r\nx-admin: 1"}, "TOKEN_INVALID", "token"),
        ({"token_file": "/nowhere"}, "FILE_UNREADABLE", "token_file"),
        ({"ca_file": "/nowhere"}, "FILE_UNREADABLE", "ca_file"),
        ({"cert_file": "/nowhere"}, "OPTIONS_CONFLICT", "key_file"),
        ({"address": "http://percept", "ca_file": "/nowhere"}, "OPTIONS_CONFLICT", "address"),
        ({"address": "https://percept", "tls": False}, "OPTIONS_CONFLICT", "tls"),
        ({"address": "https://percept/v1"}, "ADDRESS_INVALID", "address"),
        ({"address": "https://user:pass@percept"}, "ADDRESS_INVALID", "address"),
        ({"address": ""}, "ADDRESS_INVALID", "address"),
    ],
)
def test_what_contradicts_itself_is_refused_at_once(options, reason, field):
    with pytest.raises(InvalidArgument) as error:
        Client(**options)
    assert (error.value.reason, error.value.field) == (reason, field)
