"""Clients that keep the server waiting, take too much, or are not who they seem: each is ended, the others served."""

from __future__ import annotations

import contextlib
import pathlib
import signal
import ssl
import struct
import subprocess
import threading

import grpc
import httpx
import percept.zenoh
import pytest
from percept import Client
from percept.v1 import sessions_service_pb2 as sessions

from support import wire, world
from support.pki import Authority
from support.server import STOP_S, Server, binary, eventually, free_port

MIB = 1 << 20
JSON = {"content-type": "application/json"}
POST = (
    "POST /v1/sessions HTTP/1.1\r\nhost: {host}\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n\r\n"
)
GET_POSE = "/percept.v1.SessionsService/GetPose"
STREAM_FRAMES = "/percept.v1.SensorsService/StreamFrames"


@pytest.fixture
def serve(tmp_path, monkeypatch):
    """Starts servers with settings: `serve(limits_max_watchers=1)`."""
    servers = []

    def start(**settings):
        for name, value in settings.items():
            monkeypatch.setenv(f"PERCEPT_{name.upper()}", str(value))
        servers.append(Server(tmp_path / f"data{len(servers)}"))
        return servers[-1]

    yield start
    for server in servers:
        server.kill()


def serves(server) -> bool:
    """Whether both doors do what they are for."""
    with Client(server.grpc) as client:
        session = client.sessions.create()
        assert httpx.get(f"{server.rest_url}/v1/sessions/{session.session_id}", timeout=30).status_code == 200
        session.delete()
    return True


def create(server, length: int) -> bytes:
    return POST.format(host=server.rest, length=length).encode()


# What is slow


def test_slow_headers_end(serve):
    server = serve(limits_header_timeout_s=1)
    with contextlib.ExitStack() as stack:
        rest = [stack.enter_context(wire.connect(server.rest)) for _ in range(20)]
        grpc_ = [stack.enter_context(wire.connect(server.grpc)) for _ in range(20)]
        for i, sock in enumerate(rest + grpc_):
            # A third of them say nothing at all.
            sock.sendall(b"" if i % 3 == 0 else b"GET /v1/sessions HTT" if sock in rest else wire.PREFACE[:10])
        for sock in rest + grpc_:
            wire.ends(sock)
    assert serves(server)


def test_a_header_that_trickles_ends(serve):
    server = serve(limits_header_timeout_s=1)
    with wire.connect(server.rest) as sock:
        sock.sendall(b"GET / HTTP/1.1\r\n")
        sock.settimeout(0.2)
        with contextlib.suppress(ConnectionError):
            for i in range(100):
                sock.sendall(f"x-{i}: y\r\n".encode())
                with contextlib.suppress(TimeoutError):
                    if not sock.recv(100):
                        return
            pytest.fail("the header went on for 20 s")


def test_a_connection_rests_between_requests_until_it_is_idle(serve):
    server = serve(limits_header_timeout_s=1, limits_idle_timeout_s=4)
    with wire.connect(server.rest) as sock:
        request = f"GET /livez HTTP/1.1\r\nhost: {server.rest}\r\n\r\n".encode()
        sock.sendall(request)
        assert sock.recv(4096).startswith(b"HTTP/1.1 200")
        sock.settimeout(2)
        with pytest.raises(TimeoutError):
            sock.recv(1)
        sock.settimeout(wire.PATIENCE_S)
        sock.sendall(request)
        assert sock.recv(4096).startswith(b"HTTP/1.1 200")
        assert wire.ends(sock) == b""


def test_slow_bodies_end_with_a_reason(serve):
    server = serve(limits_body_timeout_s=1)
    status, text = wire.answer(server.rest, create(server, 1000) + b'{"display_name": ')
    assert status == 408
    assert "BODY_TOO_SLOW" in text
    for path in (GET_POSE, STREAM_FRAMES):
        with wire.http2(server.grpc) as sock:
            sock.sendall(wire.call(path, b"\0" + struct.pack(">I", 1000) + b"x" * 10))
            ended = next(
                f for f in wire.frames(sock) if f[2] == 1 and (f[1] & wire.END_STREAM or f[0] == wire.RST_STREAM)
            )
            assert ended
    assert serves(server)


def test_a_quiet_ingest_stream_lives_until_its_own_limit(serve):
    server = serve(limits_body_timeout_s=1, limits_stream_idle_timeout_s=5)
    with wire.http2(server.grpc) as sock:
        sock.sendall(wire.call(STREAM_FRAMES, b""))
        sock.settimeout(3)
        with pytest.raises(TimeoutError):
            next(f for f in wire.frames(sock) if f[1] & wire.END_STREAM and f[2] == 1)
        sock.settimeout(wire.PATIENCE_S)
        assert next(f for f in wire.frames(sock) if f[1] & wire.END_STREAM and f[2] == 1)


def test_an_unread_answer_ends_and_gives_its_place_back(serve):
    server = serve(limits_unread_timeout_s=1, limits_max_watchers_per_peer=1)
    with Client(server.grpc) as client:
        session = client.sessions.create(sensors=[world.LASER])
        url = f"/v1/sessions/{session.session_id}/events?resume_token=0"
        with wire.connect(server.rest) as unread:
            unread.setsockopt(wire.socket.SOL_SOCKET, wire.socket.SO_RCVBUF, 4096)
            unread.sendall(f"GET {url} HTTP/1.1\r\nhost: {server.rest}\r\n\r\n".encode())
            assert unread.recv(12).startswith(b"HTTP/1.1 200")
            stopped = threading.Event()

            def drive():
                i = 0
                while not stopped.is_set():
                    with session.stream() as stream:
                        for pose in world.drive(30):
                            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
                            i += 1

            driver = threading.Thread(target=drive)
            driver.start()
            try:

                def another_watches():
                    with httpx.stream("GET", server.rest_url + url, timeout=30) as watched:
                        return watched.status_code == 200

                assert eventually(another_watches, seconds=60)
            finally:
                stopped.set()
                driver.join()


# What is too much


def test_bodies_under_way_share_their_memory(serve):
    server = serve(
        limits_max_message_bytes=8 * MIB,
        limits_max_bytes_in_flight=16 * MIB,
        limits_max_bytes_in_flight_per_peer=16 * MIB,
    )
    assert serves(server)
    before, answers = server.peak_rss_mb(), []
    with contextlib.ExitStack() as stack:
        socks = [stack.enter_context(wire.connect(server.rest)) for _ in range(40)]
        for sock in socks:
            # Nine tenths come, the rest never does.
            with contextlib.suppress(OSError):
                sock.sendall(create(server, 8 * MIB) + b" " * (7 * MIB))
            sock.settimeout(0.01)
        for sock in socks:
            # Who still sends when the answer comes may lose it to a reset.
            with contextlib.suppress(TimeoutError):
                try:
                    answers.append(sock.recv(65536).decode())
                except ConnectionError:
                    answers.append("")
        assert len(answers) >= 30
        refused = next(a for a in answers if a.startswith("HTTP/1.1 429"))
        assert "retry-after: 1" in refused and "MEMORY_EXHAUSTED" in refused
        # 280 MiB were sent.
        assert server.peak_rss_mb() - before < 100
    assert eventually(lambda: serves(server))


def test_messages_under_way_share_their_memory(serve):
    server = serve(
        limits_max_message_bytes=8 * MIB,
        limits_max_bytes_in_flight=16 * MIB,
        limits_max_bytes_in_flight_per_peer=16 * MIB,
    )
    assert serves(server)
    before = server.peak_rss_mb()
    half = b"\0" + struct.pack(">I", 4 * MIB) + b"x" * (400 << 10)
    with contextlib.ExitStack() as stack:
        for _ in range(60):
            sock = stack.enter_context(wire.http2(server.grpc))
            sock.settimeout(0.1)
            for stream in range(1, 21, 2):
                with contextlib.suppress(OSError):
                    sock.sendall(wire.call(STREAM_FRAMES, half, stream=stream))
        # 234 MiB were sent.
        assert server.peak_rss_mb() - before < 120
    assert eventually(lambda: serves(server))


def test_connections_beyond_the_limit_are_refused_in_their_protocol(serve):
    server = serve(limits_max_connections_per_peer=4)
    with contextlib.ExitStack() as stack:
        for address in (server.rest, server.grpc):
            for _ in range(4):
                stack.enter_context(wire.http2(address) if address == server.grpc else wire.connect(address))

        def refused():
            status, text = wire.answer(server.rest, f"GET /livez HTTP/1.1\r\nhost: {server.rest}\r\n\r\n".encode())
            return status == 503 and "retry-after: 1" in text and "TOO_MANY_CONNECTIONS" in text

        assert eventually(refused)
        with wire.http2(server.grpc) as sock:
            assert any(
                kind == wire.GOAWAY and payload[4:8] == b"\0\0\0\x0b" for kind, _, _, payload in wire.frames(sock)
            )
    assert eventually(lambda: httpx.get(f"{server.rest_url}/livez").status_code == 200)
    assert serves(server)


def test_without_descriptors_for_more_connections_the_store_still_writes(tmp_path, monkeypatch):
    few = tmp_path / "percept"
    few.write_text(f'#!/bin/sh\nulimit -n 256\nexec {binary()} "$@"\n')
    few.chmod(0o755)
    monkeypatch.setenv("PERCEPT_BIN", str(few))
    server = Server(tmp_path / "data")
    try:
        with Client(server.grpc) as client, contextlib.ExitStack() as stack:
            client.sessions.create(session_id="before")
            for _ in range(300):
                with contextlib.suppress(OSError):
                    stack.enter_context(wire.connect(server.rest))
            for i in range(20):
                client.sessions.create(session_id=f"meanwhile-{i}")
        assert eventually(lambda: serves(server))
        assert server.stop() == 0, server.tail()
    finally:
        server.kill()


def test_watchers_beyond_the_limit_are_told_when_to_come_back(serve):
    server = serve(limits_max_watchers_per_peer=2)
    with Client(server.grpc) as client, contextlib.ExitStack() as stack:
        session = client.sessions.create()
        url = f"{server.rest_url}/v1/sessions/{session.session_id}/events"
        for _ in range(2):
            assert stack.enter_context(httpx.stream("GET", url, timeout=30)).status_code == 200
        third = httpx.get(url, timeout=30)
        assert (third.status_code, third.json()["reason"], third.headers["retry-after"]) == (
            429,
            "TOO_MANY_WATCHERS",
            "1",
        )
        with grpc.insecure_channel(server.grpc) as channel:
            watch = channel.unary_stream("/percept.v1.SessionsService/WatchSession")
            with pytest.raises(grpc.RpcError) as refused:
                next(watch(sessions.WatchSessionRequest(session_id=session.session_id).SerializeToString(), timeout=30))
            assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


def test_garbage_on_zenoh_is_told_once_and_counted(serve):
    server, sent = serve(), 20_000
    with Client(server.grpc) as client:
        session = client.sessions.create(sensors=[world.LASER])
        with percept.zenoh.SensorPublisher(server.zenoh, session_id=session.session_id) as publisher:
            for i in range(sent):
                publisher.publish_raw("laser", b"\xff\xff" + i.to_bytes(4, "big"))
            assert eventually(lambda: session.sensors.list()[0].rejected == sent, seconds=60)
        assert eventually(lambda: "more of the same" in server.tail(), seconds=60)
    told = [
        line for line in server.log.read_text(errors="replace").splitlines() if "PAYLOAD" in line or "refused" in line
    ]
    assert 1 <= len(told) <= 20, len(told)


def test_encoded_bodies_are_refused(serve):
    server = serve()
    bomb = {"content-type": "application/json", "content-encoding": "gzip"}
    refused = httpx.post(f"{server.rest_url}/v1/sessions", content=b"\x1f\x8b" + b"x" * 100, headers=bomb)
    assert (refused.status_code, refused.json()["reason"]) == (415, "CONTENT_ENCODING_UNSUPPORTED")


# Who is not who they seem


def test_a_page_of_elsewhere_drives_nothing(serve):
    server = serve(listen_allowed_hosts='["maps.example"]')
    root = server.rest_url

    def asked(method="GET", path="/v1/sessions", **headers):
        answer = httpx.request(method, root + path, headers=headers, content=b"{}" if method == "POST" else None)
        return answer.status_code, answer.json().get("reason") if answer.headers["content-type"].endswith(
            "json"
        ) else None

    json = {"content-type": "application/json"}
    assert asked(host="evil.example") == (421, "HOST_UNKNOWN")
    assert asked("POST", host="evil.example", **json) == (421, "HOST_UNKNOWN")
    assert asked("POST", origin="http://evil.example", **json) == (403, "ORIGIN_FORBIDDEN")
    assert asked("DELETE", "/v1/sessions/x", origin="null") == (403, "ORIGIN_FORBIDDEN")
    assert asked("GET", "/v1/sessions/x/events", origin="http://evil.example") == (403, "ORIGIN_FORBIDDEN")
    assert httpx.get(f"{root}/v1/sessions").json().get("sessions", []) == []
    assert asked("POST", origin=root, **json)[0] == 200
    assert asked(host="maps.example:8080")[0] == 200
    assert asked("POST", host="maps.example", origin="https://maps.example", **json)[0] == 200


def test_the_grpc_door_takes_no_browser(serve):
    server = serve()
    for more in (
        {"content_type": "text/plain"},
        {"origin": "http://evil.example"},
        {"content_type": "application/json"},
    ):
        with wire.http2(server.grpc) as sock:
            body = sessions.CreateSessionRequest(session_id="stolen").SerializeToString()
            sock.sendall(
                wire.call(
                    "/percept.v1.SessionsService/CreateSession",
                    b"\0" + struct.pack(">I", len(body)) + body,
                    end=True,
                    **more,
                )
            )
            assert next(f for f in wire.frames(sock) if f[2] == 1)
    # A page cannot speak HTTP/2 unless the server agrees to it in TLS.
    with wire.connect(server.grpc) as sock:
        sock.sendall(create(server, 2) + b"{}")
        assert b"HTTP/1.1 200" not in wire.ends(sock)
    with Client(server.grpc) as client:
        assert [s.session_id for s in client.sessions.list()] == []


def test_reflection_and_docs_can_be_switched_off(serve):
    def seen(server):
        pages = [httpx.get(server.rest_url + path).status_code for path in ("/docs", "/openapi.json")]
        with grpc.insecure_channel(server.grpc) as channel:
            call = channel.stream_stream("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo")
            try:
                next(call(iter([b"\x3a\x00"]), timeout=30))
            except grpc.RpcError as error:
                return pages, error.code()
        return pages, grpc.StatusCode.OK

    assert seen(serve()) == ([200, 200], grpc.StatusCode.OK)
    assert seen(serve(listen_docs="false", listen_reflection="false")) == ([404, 404], grpc.StatusCode.UNIMPLEMENTED)


# Stopping


def test_half_sent_requests_do_not_hold_the_stop(serve):
    server = serve(listen_drain_s=3600)
    with contextlib.ExitStack() as stack:
        rest = stack.enter_context(wire.connect(server.rest))
        rest.sendall(create(server, 1000) + b"{")
        header = stack.enter_context(wire.connect(server.rest))
        header.sendall(b"GET / HT")
        call = stack.enter_context(wire.http2(server.grpc))
        call.sendall(wire.call(GET_POSE, b"\0" + struct.pack(">I", 1000) + b"x"))
        stream = stack.enter_context(wire.http2(server.grpc))
        stream.sendall(wire.call(STREAM_FRAMES, b""))
        assert serves(server)
        assert server.stop() == 0, server.tail()
        assert b"STOPPING" in wire.ends(rest)


def test_it_is_unready_before_it_closes(serve):
    server = serve(listen_notice_s=3600)
    with Client(server.grpc) as client:
        assert httpx.get(f"{server.rest_url}/readyz").status_code == 200
        server.process.send_signal(signal.SIGTERM)
        assert eventually(lambda: httpx.get(f"{server.rest_url}/readyz").status_code == 503)
        health = [binary(), "health", "--server", f"http://{server.grpc}"]
        assert eventually(lambda: subprocess.run(health, capture_output=True, check=False).returncode != 0)
        assert client.sessions.create().session_id, "new work is still taken"
    server.process.send_signal(signal.SIGINT)
    assert server.process.wait(STOP_S) != 0, "Ctrl-C forces a server that is stopping, and says so"


def test_a_hang_up_does_not_stop_it(serve):
    server = serve()
    server.process.send_signal(signal.SIGHUP)
    assert serves(server)
    assert server.stop() == 0


# TLS


@pytest.fixture
def authority(tmp_path):
    return Authority(tmp_path / "pki")


def serial(address: str, ca: pathlib.Path) -> str:
    host, port = address.rsplit(":", 1)
    context = ssl.create_default_context(cafile=str(ca))
    with context.wrap_socket(wire.socket.create_connection((host, int(port)), 30), server_hostname=host) as sock:
        return sock.getpeercert()["serialNumber"]


def test_both_doors_speak_tls_and_the_tools_with_them(serve, authority):
    cert, key = authority.issue("server", "IP:127.0.0.1,DNS:localhost")
    server = serve(tls_cert_file=cert, tls_key_file=key)
    verified = ssl.create_default_context(cafile=str(authority.ca))
    assert httpx.get(f"https://{server.rest}/v1/sessions", verify=verified).status_code == 200
    credentials = grpc.ssl_channel_credentials(authority.ca.read_bytes())
    with grpc.secure_channel(server.grpc, credentials) as channel:
        listed = channel.unary_unary("/percept.v1.SessionsService/ListSessions")(b"", timeout=30)
        assert sessions.ListSessionsResponse.FromString(listed).sessions == []
    with pytest.raises(httpx.HTTPError):
        httpx.get(f"http://{server.rest}/livez")
    health = [binary(), "health", "--server", f"https://{server.grpc}"]
    assert subprocess.run([*health, "--ca-file", authority.ca], capture_output=True, check=False).returncode == 0
    unknown = subprocess.run(health, capture_output=True, check=False, text=True)
    assert unknown.returncode != 0 and "certificate" in unknown.stderr.lower(), unknown.stderr
    sim = [
        binary(),
        "sim",
        "--server",
        f"https://{server.grpc}",
        "--ca-file",
        authority.ca,
        "--duration-s",
        "1",
        "--rooms",
        "1",
    ]
    done = subprocess.run(sim, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr


def test_clients_show_certificates_where_required(serve, authority):
    cert, key = authority.issue("server", "IP:127.0.0.1")
    client_cert, client_key = authority.issue("robot-7", "DNS:robot-7.site.example,URI:spiffe://site/robot/7")
    server = serve(
        tls_cert_file=cert, tls_key_file=key, tls_client_ca_file=authority.ca, tls_client_cert_required="true"
    )
    verified = ssl.create_default_context(cafile=str(authority.ca))
    with pytest.raises(httpx.HTTPError):
        httpx.get(f"https://{server.rest}/livez", verify=verified)
    verified.load_cert_chain(client_cert, client_key)
    assert httpx.get(f"https://{server.rest}/livez", verify=verified).status_code == 200
    health = [binary(), "health", "--server", f"https://{server.grpc}", "--ca-file", authority.ca]
    assert subprocess.run(health, capture_output=True, check=False).returncode != 0
    shown = [*health, "--cert", client_cert, "--key", client_key]
    assert subprocess.run(shown, capture_output=True, check=False).returncode == 0


def test_new_certificates_are_used_and_connections_stay(serve, authority):
    cert, key = authority.issue("server", "IP:127.0.0.1")
    server = serve(tls_cert_file=cert, tls_key_file=key)
    first = serial(server.rest, authority.ca)
    verified = ssl.create_default_context(cafile=str(authority.ca))
    with httpx.Client(base_url=f"https://{server.rest}", verify=verified) as connected:
        assert connected.get("/livez").status_code == 200
        authority.issue("server", "IP:127.0.0.1")
        server.process.send_signal(signal.SIGHUP)
        assert eventually(lambda: serial(server.rest, authority.ca) != first)
        assert (
            connected.get("/livez")
            .extensions["network_stream"]
            .get_extra_info("ssl_object")
            .getpeercert()["serialNumber"]
            == first
        )
    # Without a signal, too; a file that is none leaves what was in force.
    second = serial(server.rest, authority.ca)
    cert.write_text("none")
    server.process.send_signal(signal.SIGHUP)
    assert eventually(lambda: "certificates in force stay" in server.tail())
    assert serial(server.rest, authority.ca) == second
    authority.issue("server", "IP:127.0.0.1")
    assert eventually(lambda: serial(server.rest, authority.ca) != second, seconds=30)


def test_new_certificates_are_used_over_zenoh_too(tmp_path, monkeypatch, authority):
    cert, key = authority.issue("server", "IP:127.0.0.1")
    monkeypatch.setenv("PERCEPT_TLS_CERT_FILE", str(cert))
    monkeypatch.setenv("PERCEPT_TLS_KEY_FILE", str(key))
    server = Server(tmp_path / "data", zenoh=f"tls/127.0.0.1:{free_port()}")
    try:
        endpoint = server.zenoh.removeprefix("tls/")
        first = serial(endpoint, authority.ca)
        authority.issue("server", "IP:127.0.0.1")
        server.process.send_signal(signal.SIGHUP)
        assert eventually(lambda: serial(server.rest, authority.ca) != first)

        def is_new() -> bool:
            # The door is closed for a moment.
            with contextlib.suppress(OSError):
                return serial(endpoint, authority.ca) != first
            return False

        assert eventually(is_new, seconds=30)
    finally:
        server.kill()


def test_a_handshake_that_stops_ends(serve, authority):
    cert, key = authority.issue("server", "IP:127.0.0.1")
    server = serve(tls_cert_file=cert, tls_key_file=key, limits_header_timeout_s=1)
    with contextlib.ExitStack() as stack:
        socks = [stack.enter_context(wire.connect(a)) for a in (server.rest, server.grpc) for _ in range(10)]
        for sock in socks:
            sock.sendall(b"\x16\x03\x01")
        assert serial(server.rest, authority.ca), "others are served meanwhile"
        for sock in socks:
            wire.ends(sock)


# What swells, and what is kept


def test_messages_that_swell_when_they_are_read_are_refused(own_server):
    """Empty sensors by the million, two bytes each."""
    before = own_server.peak_rss_mb()
    with grpc.insecure_channel(own_server.grpc) as channel:
        create = channel.unary_unary("/percept.v1.SessionsService/CreateSession")
        for size in (1 << 20, 8 << 20):
            with pytest.raises(grpc.RpcError) as refused:
                create(b"\x22\x00" * (size // 2), timeout=30)
            assert refused.value.code() is grpc.StatusCode.INVALID_ARGUMENT
    body = b'{"sensors":[' + b",".join([b"{}"] * (1 << 20)) + b"]}"
    answer = httpx.post(f"{own_server.rest_url}/v1/sessions", content=body, headers=JSON, timeout=60)
    assert (answer.status_code, answer.json()["reason"]) == (400, "MESSAGE_EXPANDS")
    assert own_server.peak_rss_mb() < before + 150
    assert serves(own_server)


def test_a_mask_that_says_the_same_a_thousand_times_costs_no_more(own_server):
    with Client(own_server.grpc) as client:
        session = client.sessions.create()
    before = own_server.peak_rss_mb()
    request = sessions.UpdateSessionRequest(session={"session_id": session.session_id})
    request.update_mask.paths.extend(["params"] * 10_000)
    with grpc.insecure_channel(own_server.grpc) as channel:
        update = channel.unary_unary("/percept.v1.SessionsService/UpdateSession")
        update(request.SerializeToString(), timeout=30)
    assert own_server.peak_rss_mb() < before + 40


def test_whoever_asks_for_the_contract_keeps_no_memory_of_others(own_server):
    """Reflection needs no key; large messages to it took a share of the memory for frames until it ended."""
    # `list_services` is field 7 of a ServerReflectionRequest.
    asked = b"\x3a\x01*"
    # An unknown field, of 3 MiB.
    large = asked + b"\xaa\x06\x80\x80\xc0\x01" + bytes(3 * MIB)
    done = threading.Event()

    def questions():
        yield asked
        yield large
        done.wait(30)

    with grpc.insecure_channel(own_server.grpc) as channel:
        info = channel.stream_stream("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo")
        answers = info(questions())
        assert next(answers)
        more = []
        with contextlib.suppress(grpc.RpcError):
            more = list(answers)
        done.set()
    assert not more, "the large one was answered"
    assert serves(own_server)


def test_who_watches_the_health_does_not_hold_up_the_stop(own_server):
    with grpc.insecure_channel(own_server.grpc) as channel:
        watch = channel.unary_stream("/grpc.health.v1.Health/Watch")(b"")
        # The door opens a moment before the server says of itself that it serves.
        assert b"\x08\x01" in watch
        own_server.process.send_signal(signal.SIGTERM)
        # Far below the time that requests under way are given.
        assert own_server.process.wait(10) == 0
