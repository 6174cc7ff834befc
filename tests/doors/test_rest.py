"""What REST alone has: documents, files, events, problems."""

from __future__ import annotations

import json
import re

import httpx
import pytest

from support import world


@pytest.fixture
def http(server):
    with httpx.Client(base_url=server.rest_url, timeout=30) as http:
        yield http


def test_the_document_describes_what_is_served(http):
    document = http.get("/openapi.json").json()
    assert document["openapi"].startswith("3.")
    assert {"/v1/sessions", "/v1/sessions/{session_id}/plan", "/v1/toolbox/segment-planes"} <= set(document["paths"])
    assert http.get("/").headers["content-type"].startswith("text/html")


def test_the_page_loads_nothing_from_elsewhere(http):
    page = http.get("/")
    assert "default-src 'none'" in page.headers["content-security-policy"]
    assert "<title>percept</title>" in page.text
    assert not re.search(r"<(script|link|img)\b[^>]*\b(src|href)=.(https?:)?//", page.text)


def test_the_server_says_that_it_lives(http):
    assert http.get("/livez").status_code == 200
    assert http.get("/readyz").status_code == 200


def test_a_session_by_json_alone(http, name):
    body = {"session_id": name, "sensors": [{"sensor_id": "laser", "kind": "SENSOR_KIND_LIDAR2D"}]}
    created = http.post("/v1/sessions", json=body)
    assert created.status_code == 200, created.text
    session = created.json()["session"]
    assert session["session_id"] == name
    assert isinstance(session["create_time_ns"], str), "64-bit integers are strings in protobuf's JSON"
    assert http.get(f"/v1/sessions/{name}").json()["session"]["mode"] == "SESSION_MODE_MAPPING"
    assert name in [s["session_id"] for s in http.get("/v1/sessions?page_size=1000").json()["sessions"]]
    spec = {"sensor_id": "odom", "kind": "SENSOR_KIND_ODOMETRY"}
    assert http.post(f"/v1/sessions/{name}/sensors", json={"spec": spec}).status_code == 200
    assert len(http.get(f"/v1/sessions/{name}/sensors").json()["sensors"]) == 2
    assert http.delete(f"/v1/sessions/{name}").status_code == 200
    assert http.get(f"/v1/sessions/{name}").status_code == 404


@pytest.mark.parametrize(
    ("verb", "path", "body", "status", "reason", "field"),
    [
        ("GET", "/v1/sessions/none", None, 404, "SESSION_NOT_FOUND", "session_id"),
        ("GET", "/v1/sessions/b%20d", None, 400, "ID_INVALID", "session_id"),
        ("POST", "/v1/sessions", '{"sesion_id": "a"}', 400, "JSON_INVALID", "sesion_id"),
        ("POST", "/v1/sessions", '{"session_id": ', 400, "JSON_INVALID", ""),
        ("GET", "/v1/sessions?page_size=many", None, 400, "QUERY_INVALID", "page_size"),
        ("GET", "/v1/nothing", None, 404, "ROUTE_NOT_FOUND", ""),
    ],
)
def test_what_is_wrong_is_a_problem_document(http, verb, path, body, status, reason, field):
    answer = http.request(verb, path, content=body, headers={"content-type": "application/json"})
    problem = answer.json()
    assert answer.headers["content-type"].startswith("application/problem+json")
    assert (answer.status_code, problem["reason"], problem["field"]) == (status, reason, field)
    assert problem["type"]
    assert problem["title"]
    assert problem["detail"]


def test_a_wrong_method_is_told_which_are_right(http):
    answer = http.put("/v1/sessions", json={})
    assert answer.status_code == 405
    assert "GET" in answer.headers["allow"]


def test_maps_are_files_with_tags_and_ranges(http, laser_session):
    files = f"/v1/sessions/{laser_session.session_id}/map/files"
    whole = http.get(f"{files}/occupancy.png")
    assert whole.status_code == 200
    assert whole.content.startswith(b"\x89PNG")
    tag = whole.headers["etag"]
    assert http.get(f"{files}/occupancy.png", headers={"if-none-match": tag}).status_code == 304
    part = http.get(f"{files}/occupancy.png", headers={"range": "bytes=2-5"})
    assert (part.status_code, part.content) == (206, whole.content[2:6])
    assert part.headers["content-range"] == f"bytes 2-5/{len(whole.content)}"
    beyond = http.get(f"{files}/occupancy.png", headers={"range": f"bytes={len(whole.content)}-"})
    assert beyond.status_code == 416
    assert http.get(f"{files}/map.yaml").text.splitlines()[0].startswith("image: map.pgm")
    assert http.get(f"{files}/map.pgm").content.startswith(b"P5")
    assert http.get(f"{files}/nothing.obj").status_code == 404


def test_a_packed_file_is_as_exact_as_is_asked_for(http, lidar_session):
    files = f"/v1/sessions/{lidar_session.session_id}/map/files"
    sizes = [len(http.get(f"{files}/cloud.drc", params={"max_error_m": m}).content) for m in (0.0005, 0.01)]
    assert sizes[1] < len(http.get(f"{files}/cloud.drc").content) < sizes[0]
    assert http.get(f"{files}/mesh.drc").content.startswith(b"DRACO")
    for name, params in [("cloud.drc", {"max_error_m": 7}), ("cloud.ply", {"max_error_m": 0.01})]:
        refused = http.get(f"{files}/{name}", params=params)
        assert (refused.status_code, refused.json()["field"]) == (400, "max_error_m")
    assert http.get(f"{files}/cloud.drc", params={"format": 4}).json()["reason"] == "QUERY_INVALID"


def test_a_part_of_a_map_at_a_coarser_resolution(http, laser_session):
    own = laser_session.map.summary().occupancy.resolution_m
    where = {"region.min.x": -1, "region.min.y": -1, "region.max.x": 1, "region.max.y": 1}
    answer = http.get(
        f"/v1/sessions/{laser_session.session_id}/map/occupancy", params=where | {"resolution_m": 2 * own}
    )
    geometry = answer.json()["chunk"]["geometry"]
    assert geometry["resolution_m"] == pytest.approx(2 * own)
    assert 2 / (2 * own) - 1 <= geometry["width"] <= 2 / (2 * own) + 2


def test_the_scene_graph_is_json_or_graphviz(http, laser_session):
    path = f"/v1/sessions/{laser_session.session_id}/scene-graph"
    nodes = http.get(path).json()["graph"]["nodes"]
    assert any(n["kind"] == "SCENE_NODE_KIND_ROBOT" for n in nodes)
    dot = http.get(path, headers={"accept": "text/vnd.graphviz"})
    assert dot.headers["content-type"].startswith("text/vnd.graphviz")
    assert dot.text.lstrip().startswith(("digraph", "strict digraph"))


def test_events_come_as_they_happen_and_resume(http, client):
    session = client.sessions.create(sensors=[world.LASER])
    poses = world.drive(4)

    def send(i):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))

    def read(response, count):
        events = []
        for line in response.iter_lines():
            if line.startswith("data:"):
                events.append(json.loads(line[5:]))
                if len(events) == count:
                    return events
        return events

    path = f"/v1/sessions/{session.session_id}/events"
    send(0)
    with http.stream("GET", path, params={"resume_token": 0}) as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        first = read(response, 2)
    tokens = [int(e["token"]) for e in first]
    assert tokens[1] == tokens[0] + 1
    send(1)
    with http.stream("GET", path, headers={"last-event-id": str(tokens[1])}) as response:
        assert int(read(response, 1)[0]["token"]) == tokens[1] + 1
