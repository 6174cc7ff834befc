"""What a server tells about itself: metrics, readiness, traces, a line for each request."""

from __future__ import annotations

import json
import re
from concurrent.futures import ThreadPoolExecutor

import grpc
import httpx
import pytest
from google.rpc import error_details_pb2, status_pb2
from percept import Client
from percept.v1 import sessions_service_pb2

from support import world
from support.prometheus import Metrics, Prometheus, tool
from support.server import REPO, Server, eventually

TRACE = "4bf92f3577b34da6a3ce929d0e0e4736"
TRACEPARENT = f"00-{TRACE}-00f067aa0ba902b7-01"
#: Answers of gRPC health: field 1 is the status.
SERVING, NOT_SERVING = b"\x08\x01", b"\x08\x02"
DASHBOARD = REPO / "deploy" / "monitoring" / "grafana" / "dashboard.json"


@pytest.fixture
def told_server(tmp_path, monkeypatch):
    """A server that logs every request and serves its metrics apart."""
    monkeypatch.setenv("PERCEPT_TELEMETRY_ACCESS_LOG", "1")
    monkeypatch.setenv("PERCEPT_TELEMETRY_LISTEN", "127.0.0.1:0")
    monkeypatch.setenv("PERCEPT_LOG_FORMAT", "json")
    # As for a load balancer; those who watch see what is told meanwhile.
    monkeypatch.setenv("PERCEPT_LISTEN_NOTICE_S", "2")
    server = Server(tmp_path / "data")
    yield server
    server.kill()


def drive(client: Client, frames: int):
    session = client.sessions.create(sensors=[world.LASER])
    with session.stream() as stream:
        for i, pose in enumerate(world.drive(frames)):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    assert stream.summary.rejected == 0, stream.summary.rejections
    return session


def test_frames_and_requests_are_counted(own_server):
    before = Metrics(own_server.rest_url)
    with Client(own_server.grpc) as client:
        session = drive(client, 12)
        session.pose()
        with pytest.raises(Exception, match=r"unused|not"):
            client.session("nobody").pose()
        httpx.get(f"{own_server.rest_url}/v1/sessions/{session.session_id}/pose").raise_for_status()
        # A second frame of the same stamp.
        with session.stream() as stream:
            stream.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
        assert stream.summary.rejected == 1
    after = Metrics(own_server.rest_url)

    def grown(name, **labels):
        return after.sum(name, **labels) - before.sum(name, **labels)

    assert grown("percept_frames_accepted_total", kind="lidar2d") == 12
    assert grown("percept_frame_processing_seconds_count", kind="lidar2d") == 12
    assert grown("percept_frames_refused_total", kind="lidar2d") == 1
    get_pose = {"operation": "SessionsService/GetPose"}
    assert grown("percept_requests_total", door="grpc", code="OK", **get_pose) == 1
    assert grown("percept_requests_total", door="grpc", code="NOT_FOUND", **get_pose) == 1
    assert grown("percept_requests_total", door="rest", code="OK", **get_pose) == 1
    assert grown("percept_refusals_total", reason="SESSION_NOT_FOUND") == 1
    assert grown("percept_frame_durable_seconds_count") == 12
    assert after.sum("percept_store_backlog") == 0
    assert grown("percept_compute_wait_seconds_count", kind="frame") >= 12
    assert after.sum("percept_compute_waiting") == after.sum("percept_compute_running") == 0
    assert after.sum("percept_connections", door="rest") >= 1
    assert grown("percept_keyframes") >= 1
    assert grown("percept_sessions_tracking", state="tracking") == 1
    assert after.sum("process_resident_memory_bytes") > after.sum("percept_allocated_memory_bytes") > 1e6
    assert after.sum("process_open_fds") > 5
    assert after.sum("percept_build_info") == 1


def test_a_stream_is_open_until_it_ends(own_server):
    with Client(own_server.grpc) as client:
        session = client.sessions.create(sensors=[world.LASER])
        assert Metrics(own_server.rest_url).sum("percept_streams", kind="ingest") == 0
        with session.stream() as stream:
            stream.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
            assert eventually(lambda: Metrics(own_server.rest_url).sum("percept_streams", kind="ingest") == 1)
        assert eventually(lambda: Metrics(own_server.rest_url).sum("percept_streams", kind="ingest") == 0)


def test_paths_that_somebody_invents_make_no_series(own_server):
    Metrics(own_server.rest_url)
    before = len(Metrics(own_server.rest_url).series)
    channel = grpc.insecure_channel(own_server.grpc)
    for i in range(50):
        httpx.get(f"{own_server.rest_url}/v1/invented-{i}")
        with pytest.raises(grpc.RpcError):
            channel.unary_unary(f"/invented.Service{i}/Method")(b"", timeout=10)
    channel.close()
    after = Metrics(own_server.rest_url)
    assert after.sum("percept_requests_total", operation="unknown") == 100
    # At each door the count, and the times: sum, count and a bucket each.
    assert len(after.series) - before < 50


def test_metrics_may_be_served_apart_and_not_at_all(told_server, tmp_path, monkeypatch):
    assert httpx.get(f"{told_server.rest_url}/metrics").status_code == 404
    apart = f"http://{told_server.doors['telemetry']}"
    assert Metrics(apart).sum("percept_ready") == 1
    assert httpx.get(f"{apart}/readyz").json() == {"ready": True, "reasons": []}
    assert httpx.get(f"{apart}/v1/sessions").status_code == 404, "nothing but telemetry is served there"
    assert httpx.get(f"{apart}/metrics", headers={"host": "evil.example"}).status_code == 421
    monkeypatch.setenv("PERCEPT_TELEMETRY_LISTEN", "")
    monkeypatch.setenv("PERCEPT_TELEMETRY_METRICS", "false")
    quiet = Server(tmp_path / "quiet")
    try:
        assert httpx.get(f"{quiet.rest_url}/metrics").status_code == 404
        assert httpx.get(f"{quiet.rest_url}/livez").status_code == 200
    finally:
        quiet.kill()


def test_a_server_that_stops_is_no_longer_ready(told_server):
    apart = f"http://{told_server.doors['telemetry']}"
    channel = grpc.insecure_channel(told_server.grpc)
    # Who watches is told.
    told = channel.unary_stream("/grpc.health.v1.Health/Watch")(b"", timeout=60)
    assert next(told) == SERVING
    told_server.process.terminate()
    assert next(told) == NOT_SERVING
    answer = httpx.get(f"{apart}/readyz")
    assert (answer.status_code, answer.json()["ready"]) == (503, False)
    assert [(r["part"], r["reason"]) for r in answer.json()["reasons"]] == [("server", "STOPPING")]
    assert httpx.get(f"{apart}/livez").status_code == 200
    # And does not hold the server up.
    assert told_server.process.wait(15) == 0
    told.cancel()
    channel.close()


def test_grpc_health_knows_every_service(own_server):
    channel = grpc.insecure_channel(own_server.grpc)
    check = channel.unary_unary("/grpc.health.v1.Health/Check")
    for service in [b"", b"percept.v1.SessionsService", b"percept.v1.ServerService"]:
        # Field 1 of the request is the service's name.
        asked = b"\x0a" + bytes([len(service)]) + service if service else b""
        assert check(asked, timeout=10) == SERVING, service
    channel.close()


def test_a_callers_trace_is_in_answers_errors_and_log(told_server):
    answer = httpx.get(f"{told_server.rest_url}/v1/sessions/nobody", headers={"traceparent": TRACEPARENT})
    assert answer.json()["trace_id"] == TRACE
    assert answer.headers["traceresponse"].split("-")[1] == TRACE
    channel = grpc.insecure_channel(told_server.grpc)
    call = channel.unary_unary(
        "/percept.v1.SessionsService/GetPose",
        request_serializer=sessions_service_pb2.GetPoseRequest.SerializeToString,
    )
    with pytest.raises(grpc.RpcError) as refused:
        call(
            sessions_service_pb2.GetPoseRequest(session_id="nobody"),
            metadata=[("traceparent", TRACEPARENT)],
            timeout=10,
        )
    channel.close()
    trailers = dict(refused.value.trailing_metadata())
    status = status_pb2.Status.FromString(trailers["grpc-status-details-bin"])
    info = error_details_pb2.ErrorInfo()
    assert any(detail.Unpack(info) for detail in status.details)
    assert (info.reason, info.metadata["trace_id"]) == ("SESSION_NOT_FOUND", TRACE)

    def lines():
        found = [json.loads(line) for line in told_server.log.read_text().splitlines() if line.startswith("{")]
        found = [line for line in found if line["target"] == "access" and line["trace_id"] == TRACE]
        return found if len(found) == 2 else None

    rest, over_grpc = eventually(lines)
    assert (rest["door"], rest["operation"], rest["code"]) == ("rest", "SessionsService/GetSession", "NOT_FOUND")
    assert (over_grpc["door"], over_grpc["operation"]) == ("grpc", "SessionsService/GetPose")
    assert over_grpc["peer"].startswith("127.0.0.1:")


@pytest.mark.parametrize("sent", [None, "", "nonsense", "00-" + "0" * 32 + "-00f067aa0ba902b7-01", TRACEPARENT.upper()])
def test_a_request_without_a_trace_gets_one_of_its_own(server, sent):
    headers = {} if sent is None else {"traceparent": sent}
    traces = [httpx.get(f"{server.rest_url}/v1/sessions/nobody", headers=headers).json()["trace_id"] for _ in range(2)]
    assert all(re.fullmatch("[0-9a-f]{32}", trace) for trace in traces)
    assert traces[0] != traces[1]


def panels():
    queries = []
    for panel in json.loads(DASHBOARD.read_text())["panels"]:
        for target in panel.get("targets", []):
            query = target["expr"].replace("$__rate_interval", "10s").replace("$instance", ".*")
            queries.append(pytest.param(panel["title"], query, id=f"{panel['title']} {target['refId']}"))
    return queries


@pytest.fixture(scope="module")
def prometheus(tmp_path_factory):
    """A Prometheus that has scraped a server through a drive."""
    if tool("prometheus") is None:
        pytest.skip("no prometheus: install the package, or name its folder in PROMETHEUS_DIR")
    folder = tmp_path_factory.mktemp("prometheus")
    server = Server(folder / "data")
    watching = Prometheus(folder, server.rest)
    try:
        # Once before anything happened: a rate needs two.
        assert watching.wait('up{job="percept"} == 1'), (folder / "prometheus.log").read_text()[-2000:]
        with Client(server.grpc) as client:
            drive(client, 12).pose()
            with pytest.raises(Exception):  # noqa: B017, PT011
                client.session("nobody").pose()
        counted = [
            'increase(percept_frames_accepted_total{kind="lidar2d"}[10s]) > 0',
            'rate(percept_requests_total{code="NOT_FOUND"}[10s])',
        ]
        for query in counted:
            assert watching.wait(query), (folder / "prometheus.log").read_text()[-2000:]
        yield watching
    finally:
        watching.stop()
        server.kill()


@pytest.mark.parametrize(("title", "query"), panels())
def test_every_panel_of_the_dashboard_has_an_answer(prometheus, title, query):
    assert prometheus.query(query), f"{title}: {query}"


def test_every_metric_that_alerts_and_panels_name_exists(server):
    text = DASHBOARD.read_text() + (REPO / "deploy" / "monitoring" / "alerts.yml").read_text()
    # Those that have a series by now, and those that wait for their first.
    answer = httpx.get(f"{server.rest_url}/metrics").text
    families = {line.split()[2] for line in answer.splitlines() if line.startswith("# TYPE ")}
    declared = (REPO / "server" / "service" / "src" / "observe" / "families.rs").read_text()
    families |= {f"percept_{name}" for name in re.findall(r'\bto\.\w+\("(\w+)"', declared)}
    named = set(re.findall(r"\b(?:percept|process)_[a-z_]+\b", text))
    known = {name + suffix for name in families for suffix in ("", "_total", "_bucket", "_sum", "_count")}
    assert named - known == set()
    assert len(named) > 30


def test_no_metric_has_a_label_by_session(server, client, name):
    client.sessions.create(session_id=name)
    text = httpx.get(f"{server.rest_url}/metrics").text
    assert name not in text


class Collector:
    """Takes spans as OTLP over gRPC brings them."""

    def __init__(self) -> None:
        self.received = b""
        method = grpc.unary_unary_rpc_method_handler(self._export)
        service = "opentelemetry.proto.collector.trace.v1.TraceService"
        self._server = grpc.server(ThreadPoolExecutor(2))
        self._server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(service, {"Export": method}),))
        self.port = self._server.add_insecure_port("127.0.0.1:0")
        self._server.start()

    def _export(self, request: bytes, _) -> bytes:
        self.received += request
        return b""

    def stop(self) -> None:
        self._server.stop(None)


def test_spans_go_to_a_collector_under_the_callers_trace(tmp_path, monkeypatch):
    collector = Collector()
    monkeypatch.setenv("PERCEPT_TELEMETRY_OTLP_ENDPOINT", f"http://127.0.0.1:{collector.port}")
    monkeypatch.setenv("PERCEPT_TELEMETRY_TRACE_SHARE", "0")
    server = Server(tmp_path / "data")
    try:
        # Sampled by its caller; begun here and, at a share of 0, not recorded; not sampled by its caller.
        own = httpx.get(f"{server.rest_url}/v1/sessions/nobody").json()["trace_id"]
        quiet = "0af7651916cd43dd8448eb211c80319c"
        for trace in (TRACEPARENT, f"00-{quiet}-b7ad6b7169203331-00"):
            httpx.get(f"{server.rest_url}/v1/server", headers={"traceparent": trace}).raise_for_status()
        # What waits is sent before it stops.
        assert server.stop() == 0
    finally:
        server.kill()
        collector.stop()
    assert bytes.fromhex(TRACE) in collector.received
    assert b"ServerService/GetServerInfo" in collector.received
    assert bytes.fromhex(own) not in collector.received
    assert bytes.fromhex(quiet) not in collector.received
