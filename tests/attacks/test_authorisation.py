"""Who may do what: every rpc, route and zenoh key, tried with every kind of credentials.

The rpcs are the contract's and the routes the OpenAPI document's, so that a new one without a rule fails here.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import subprocess

import grpc
import httpx
import percept.v1
import pytest
import zenoh
from google.rpc import error_details_pb2, status_pb2
from percept.v1 import sensor_pb2

from support.server import Server, binary, free_port

# What each rpc needs, and whether it is about a session. A service without sessions has one line.
READ, WRITE, ADMIN = "read", "write", "admin"
RULES = {
    "SessionsService/CreateSession": (WRITE, True),
    "SessionsService/GetSession": (READ, True),
    "SessionsService/ListSessions": (READ, False),
    "SessionsService/UpdateSession": (WRITE, True),
    "SessionsService/DeleteSession": (ADMIN, True),
    "SessionsService/StartRecording": (WRITE, True),
    "SessionsService/StopRecording": (WRITE, True),
    "SessionsService/ListRecordings": (READ, True),
    "SessionsService/DeleteRecording": (ADMIN, True),
    "SessionsService/GetPose": (READ, True),
    "SessionsService/SetPose": (WRITE, True),
    "SessionsService/LookupTransform": (READ, True),
    "SessionsService/GetTrajectory": (READ, True),
    "SessionsService/ListKeyframes": (READ, True),
    "SessionsService/WatchSession": (READ, True),
    "SessionsService/WatchSessions": (READ, False),
    "SessionsService/GetDefaultParams": (READ, False),
    "SensorsService/DeclareSensor": (WRITE, True),
    "SensorsService/GetSensor": (READ, True),
    "SensorsService/ListSensors": (READ, True),
    "SensorsService/UpdateSensor": (WRITE, True),
    "SensorsService/StreamFrames": (WRITE, True),
    "SensorsService/SendFrame": (WRITE, True),
    "SensorsService/SyncTime": (READ, False),
    "MapsService/GetMapSummary": (READ, True),
    "MapsService/GetOccupancyGrid": (READ, True),
    "MapsService/GetCloud": (READ, True),
    "MapsService/ListLoops": (READ, True),
    "MapsService/SetLoopVeto": (WRITE, True),
    "MapsService/OptimiseMap": (WRITE, True),
    "MapsService/ImportMap": (WRITE, True),
    "MapsService/CompareMaps": (READ, True),
    "MapsService/ExportMap": (READ, True),
    "SceneService/ListObjects": (READ, True),
    "SceneService/GetObject": (READ, True),
    "SceneService/GetSceneGraph": (READ, True),
    "SceneService/GetRooms": (READ, True),
    "SceneService/NameRoom": (WRITE, True),
    "SceneService/CorrectObject": (WRITE, True),
    "SceneService/ListObjectClasses": (READ, True),
    "SceneService/ForgetObjectClass": (WRITE, True),
    "SceneService/RouteToRoom": (READ, True),
    "LayersService": (READ, True),
    "NavigationService/PlanPath": (READ, True),
    "NavigationService/DrawPath": (READ, True),
    "NavigationService/ValidatePath": (READ, True),
    "NavigationService/PlanCoverage": (READ, True),
    "NavigationService/FindFrontiers": (READ, True),
    "NavigationService/PlanFlight": (READ, True),
    "NavigationService/WatchPath": (READ, True),
    "NavigationService/Navigate": (WRITE, True),
    "ToolboxKeptCloudsService": (WRITE, False),
    "ToolboxCloudsService": (WRITE, False),
    "ToolboxShapesService": (WRITE, False),
    "ToolboxSegmentationService": (WRITE, False),
    "ToolboxRegistrationService": (WRITE, False),
    "ToolboxDepthService": (WRITE, False),
    "ToolboxImagesService": (WRITE, False),
    "ToolboxPicturesService": (WRITE, False),
    "ToolboxPipelinesService": (WRITE, False),
    "ToolboxPlanningService": (WRITE, False),
    "EvaluationService": (WRITE, False),
    # Of others' there is nothing to see; what may be started, test_operations.py tries.
    "DetectorsService/UploadDetector": (WRITE, False),
    "DetectorsService/ListDetectors": (READ, False),
    "DetectorsService/DeleteDetector": (ADMIN, False),
    "OperationsService": (READ, False),
    "ServerService": (READ, False),
}
PAGES_OPEN = {"/", "/docs", "/openapi.json", "/reasons", "/livez", "/readyz", "/healthz"}
#: Sums over all sessions: for an admin of all of them, which of these kinds is the stranger at home.
METRICS = "/metrics"

REFUSED = {
    "none": "CREDENTIALS_MISSING",
    "malformed": "CREDENTIALS_INVALID",
    "forged": "CREDENTIALS_INVALID",
    "expired": "CREDENTIALS_EXPIRED",
    "revoked": "CREDENTIALS_REVOKED",
}
KNOWN = ("other tenant", "read only", "wrong pattern", "right")
KINDS = (*REFUSED, *KNOWN)
ALLOWED = "allowed"


def services():
    """Every service of the contract, by its short name."""
    found = {}
    for module in pkgutil.iter_modules(percept.v1.__path__):
        if module.name.endswith("_service_pb2"):
            descriptor = importlib.import_module(f"percept.v1.{module.name}").DESCRIPTOR
            found |= {name: (descriptor, service) for name, service in descriptor.services_by_name.items()}
    return found


RPCS = sorted(f"{name}/{m.name}" for name, (_, service) in services().items() for m in service.methods)


def rule(rpc: str) -> tuple[str, bool]:
    found = RULES.get(rpc) or RULES.get(rpc.split("/")[0])
    assert found, f"{rpc} is new: say in RULES, and in service/src/caller/rules.rs, what it needs"
    return found


def expected(rpc: str, kind: str) -> str:
    """What becomes of a call."""
    access, about_session = rule(rpc)
    if kind in REFUSED:
        return REFUSED[kind]
    if kind == "read only":
        return ALLOWED if access == READ else "PERMISSION_DENIED"
    if not about_session or kind == "right":
        return ALLOWED
    if rpc == "SessionsService/CreateSession":
        # Ids are unique among all tenants; a pattern says which ones a key may take.
        return "SESSION_EXISTS" if kind == "other tenant" else "PERMISSION_DENIED"
    return "SESSION_NOT_FOUND"


def keys(file, *arguments) -> dict:
    command = [binary(), "keys", *map(str, arguments[:1]), "--file", file, *map(str, arguments[1:])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    return json.loads(done.stdout) if "--json" in arguments else {}


def make_keys(file) -> dict[str, str | None]:
    """A key, or token, of each kind."""

    def create(name, tenant="ours", scope=ADMIN, sessions="fleet-*"):
        given = ("--name", name, "--tenant", tenant, "--scope", scope, "--sessions", sessions)
        return keys(file, "create", *given, "--json")

    made = {
        "expired": create("expired"),
        "revoked": create("revoked"),
        "other tenant": create("stranger", tenant="theirs", sessions="*"),
        "read only": create("reader", scope=READ),
        "wrong pattern": create("elsewhere", sessions="depot-*"),
        "right": create("driver"),
    }
    keys(file, "revoke", made["revoked"]["id"])
    stored = json.loads(file.read_text())
    for record in stored["keys"]:
        if record["name"] == "expired":
            record["expires_s"] = record["created_s"] - 1
    file.write_text(json.dumps(stored))
    own = made["right"]["key"]
    forged = own[:-1] + ("A" if own[-1] != "A" else "Q")
    texts: dict[str, str | None] = {kind: record["key"] for kind, record in made.items()}
    return texts | {"none": None, "malformed": "pk_", "forged": forged}


class Site:
    """A server that asks who calls, and credentials of every kind."""

    def __init__(self, folder) -> None:
        self.keys_file = folder / "keys.json"
        self.keys = make_keys(self.keys_file)
        users = folder / "users"
        users.write_text("reader:r\nwriter:w\nstranger:s\n")
        entries = [
            ("reader", "ours", READ, "fleet-*"),
            ("writer", "ours", WRITE, "fleet-*"),
            ("stranger", "theirs", ADMIN, "depot-*"),
        ]
        zenoh_users = "".join(
            f'[[auth.zenoh_users]]\nuser = "{u}"\ntenant = "{t}"\naccess = "{a}"\nsessions = "{s}"\n'
            for u, t, a, s in entries
        )
        config = folder / "percept.toml"
        config.write_text(
            f'[auth]\nmode = "required"\nkeys_file = "{self.keys_file}"\nzenoh_users_file = "{users}"\n{zenoh_users}'
        )
        self.server = Server(folder / "data", "--config", str(config))
        self.channel = grpc.insecure_channel(self.server.grpc)
        self.http = httpx.Client(base_url=self.server.rest_url, timeout=30)

    def headers(self, kind: str) -> dict[str, str]:
        key = self.keys[kind]
        return {} if key is None else {"authorization": f"Bearer {key}"}

    def create(self, session: str) -> None:
        answer = self.http.post("/v1/sessions", json={"session_id": session}, headers=self.headers("right"))
        assert answer.status_code == 200 or answer.json()["reason"] == "SESSION_EXISTS", answer.text

    def close(self) -> None:
        self.channel.close()
        self.http.close()
        self.server.kill()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site = Site(tmp_path_factory.mktemp("site"))
    yield site
    site.close()


def odometry(session: str) -> sensor_pb2.SensorMessage:
    message = sensor_pb2.SensorMessage(session_id=session, sensor_id="none", stamp_ns=1)
    message.odometry.t_odom_base.rotation.w = 1
    return message


def request_of(method, session: str):
    """A request about a session, wherever it is named."""
    request = importlib.import_module(method.input_type.file.name[:-6].replace("/", ".") + "_pb2")
    request = getattr(request, method.input_type.name)()
    fields = method.input_type.fields_by_name
    if "session_id" in fields:
        request.session_id = session
    if "session" in fields:
        request.session.session_id = session
        request.session.display_name = "A"
    if "source" in fields and fields["source"].message_type.name == "MapSource":
        request.source.session_id = session
    if "message" in fields:
        request.message.CopyFrom(odometry(session))
    if "spec" in fields and fields["spec"].message_type.name == "SensorSpec":
        request.spec.sensor_id = "s"
        request.spec.kind = sensor_pb2.SENSOR_KIND_ODOMETRY
    if "sensor_id" in fields:
        request.sensor_id = "s"
    if "format" in fields and fields["format"].enum_type.name == "MapFormat":
        request.format = 1
    if "goal" in fields:
        request.goal.SetInParent()
    return request


def reason_of(error: grpc.RpcError) -> str:
    """The reason in an error's details; the code where there is none."""
    for name, value in error.trailing_metadata() or ():
        if name == "grpc-status-details-bin":
            for detail in status_pb2.Status.FromString(value).details:
                info = error_details_pb2.ErrorInfo()
                if detail.Unpack(info):
                    return info.reason
    return error.code().name


DENIED = {*REFUSED.values(), "PERMISSION_DENIED", "SESSION_NOT_FOUND", "SESSION_EXISTS"}


def call(site: Site, rpc: str, session: str, kind: str) -> str:
    """What became of a call over gRPC."""
    name, method_name = rpc.split("/")
    method = services()[name][1].methods_by_name[method_name]
    answer = importlib.import_module(method.output_type.file.name[:-6].replace("/", ".") + "_pb2")
    answer = getattr(answer, method.output_type.name)
    request = request_of(method, session)
    metadata = [(k, v) for k, v in site.headers(kind).items()]
    streams = (method.client_streaming, method.server_streaming)
    shape = {
        (False, False): site.channel.unary_unary,
        (False, True): site.channel.unary_stream,
        (True, False): site.channel.stream_unary,
        (True, True): site.channel.stream_stream,
    }[streams]
    invoke = shape(
        f"/percept.v1.{rpc}",
        request_serializer=lambda m: m.SerializeToString(),
        response_deserializer=answer.FromString,
    )
    sent = iter([request]) if method.client_streaming else request
    try:
        if not method.server_streaming:
            invoke(sent, metadata=metadata, timeout=30)
            return ALLOWED
        stream = invoke(sent, metadata=metadata, timeout=30)
        if method_name.startswith("Watch"):
            # Headers come when the watch has begun; events may never.
            begun = stream.initial_metadata()
            if stream.is_active() and not any(k == "grpc-status" for k, _ in begun):
                stream.cancel()
                return ALLOWED
        first = next(iter(stream), None)
        stream.cancel()
        if method_name == "StreamFrames" and first is not None and first.ack.HasField("rejection"):
            return first.ack.rejection.reason if first.ack.rejection.reason in DENIED else ALLOWED
        return ALLOWED
    except grpc.RpcError as error:
        reason = reason_of(error)
        return reason if reason in DENIED or error.code() in AUTH_CODES else ALLOWED


AUTH_CODES = {grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED}


def test_who_may_create_some_sessions_is_told_to_name_one(site):
    answer = site.http.post("/v1/sessions", json={}, headers=site.headers("right"))
    assert answer.json()["reason"] == "PERMISSION_DENIED"
    assert "no session_id is given" in answer.json()["detail"]
    assert "give one of fleet-*" in answer.json()["detail"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rpc", RPCS)
def test_every_rpc_answers_each_kind_of_caller_as_the_table_says(site, rpc, kind):
    session = "fleet-" + rpc.split("/")[1].lower()
    # Creating succeeds for an id that is free alone; everybody else tries one that is taken.
    creates = rpc == "SessionsService/CreateSession" and kind == "right"
    if rule(rpc)[1] and not creates:
        site.create(session)
    assert call(site, rpc, "fleet-created" if creates else session, kind) == expected(rpc, kind)


def routes(site: Site) -> list[tuple[str, str, str]]:
    document = site.http.get("/openapi.json").json()
    found = []
    for path, verbs in document["paths"].items():
        for verb, operation in verbs.items():
            found.append((verb.upper(), path, operation["operationId"]))
    return found


def rpc_of(operation: str) -> str | None:
    found = [rpc for rpc in RPCS if rpc.split("/")[1] == operation]
    return found[0] if found else None


def test_every_route_answers_each_kind_of_caller_as_the_table_says(site):
    wrong = []
    for verb, path, operation in routes(site):
        rpc = rpc_of(operation)
        for kind in KINDS:
            session = "fleet-" + operation.lower()
            creates = operation == "CreateSession" and kind == "right"
            if rpc and rule(rpc)[1] and not creates:
                site.create(session)
            concrete = path.replace("{session_id}", session).replace("{name}", "map.yaml")
            concrete = concrete.replace("{handle}", "c-0").replace("{object_id}", "1").replace("{loop_id}", "1")
            concrete = concrete.replace("{room_id}", "1").replace("{label}", "x")
            concrete = concrete.replace("{sensor_id}", "s").replace("{operation_id}", "op-0")
            body = {"session_id": "fleet-by-rest" if creates else session} if operation == "CreateSession" else {}
            if operation == "DeclareSensor":
                body = {"spec": {"sensor_id": "s", "kind": "SENSOR_KIND_ODOMETRY"}}
            if operation == "UpdateSession":
                body = {"display_name": "A"}
            if operation == "UpdateSensor":
                body = {"overload_policy": "OVERLOAD_POLICY_BLOCK"}
            sent = {"json": body} if verb in ("POST", "PATCH") else {}
            with site.http.stream(verb, concrete, headers=site.headers(kind), **sent) as answer:
                if answer.status_code < 400:
                    outcome = ALLOWED
                else:
                    answer.read()
                    problem = answer.json()
                    outcome = problem["reason"] if problem["reason"] in DENIED else ALLOWED
                    if answer.status_code == 401:
                        assert answer.headers["www-authenticate"].startswith("Bearer")
                    assert (answer.status_code == 401) == (kind in REFUSED), f"{verb} {path} {kind}"
            assert rpc or path in {*PAGES_OPEN, METRICS}, f"{path} is new: say who may have it"
            should_be = expected(rpc, kind) if rpc else ALLOWED
            if path == METRICS and kind != "other tenant":
                should_be = REFUSED.get(kind, "PERMISSION_DENIED")
            if outcome != should_be:
                wrong.append(f"{verb} {path} {kind}: {outcome}, not {should_be}")
    assert wrong == []


def test_what_is_not_there_is_told_to_nobody_but_those_who_may_look(site):
    assert site.http.get("/v1/nothing").status_code == 401
    assert site.http.get("/v1/nothing", headers=site.headers("right")).status_code == 404


def test_another_tenants_session_is_answered_as_one_that_does_not_exist(site):
    site.create("fleet-secret")
    there = site.http.get("/v1/sessions/fleet-secret", headers=site.headers("other tenant"))
    absent = site.http.get("/v1/sessions/fleet-absent", headers=site.headers("other tenant"))
    assert there.status_code == absent.status_code == 404
    assert there.json()["detail"].replace("secret", "absent") == absent.json()["detail"]


def test_who_may_too_little_is_told_what_is_missing_and_for_which_session(site):
    site.create("fleet-named")
    told = site.http.delete("/v1/sessions/fleet-named", headers=site.headers("read only")).json()["detail"]
    assert "admin" in told and "fleet-named" in told


def test_lists_show_what_the_caller_may_read(site):
    site.create("fleet-listed")

    def listed(kind):
        answer = site.http.get("/v1/sessions?page_size=1000", headers=site.headers(kind)).json()
        return {s["session_id"] for s in answer["sessions"]}

    assert "fleet-listed" in listed("right") & listed("read only")
    assert listed("other tenant") == listed("wrong pattern") == set()


def test_a_request_id_of_another_tenant_gives_nothing_of_theirs(site):
    body = {"session_id": "fleet-once", "request_id": "same"}
    assert site.http.post("/v1/sessions", json=body, headers=site.headers("right")).status_code == 200
    body = {"session_id": "theirs-once", "request_id": "same"}
    answer = site.http.post("/v1/sessions", json=body, headers=site.headers("other tenant"))
    assert answer.json()["session"]["session_id"] == "theirs-once"


def test_kept_clouds_are_their_owners_alone(site):
    cloud = {"cloud": {"cloud": {"num_points": 1, "positions": "AAAAAAAAAAAAAAAA"}}}
    kept = site.http.post("/v1/toolbox/clouds", json=cloud, headers=site.headers("right"))
    handle = kept.json()["kept"]["handle"]
    for kind in ("other tenant", "wrong pattern"):
        headers = site.headers(kind)
        assert site.http.get(f"/v1/toolbox/clouds/{handle}", headers=headers).status_code == 404
        assert site.http.delete(f"/v1/toolbox/clouds/{handle}", headers=headers).status_code == 404
        assert handle not in site.http.get("/v1/toolbox/clouds", headers=headers).text
    assert site.http.get(f"/v1/toolbox/clouds/{handle}", headers=site.headers("right")).status_code == 200


def test_a_sessions_cloud_is_worked_on_by_those_who_may_read_the_session(site):
    site.create("fleet-cloud")
    for session in ("fleet-cloud", "fleet-absent"):
        body = {"cloud": {"session": {"session_id": session}}}

        def reason(kind, body=body):
            answer = site.http.post("/v1/toolbox/transform-cloud", json=body, headers=site.headers(kind))
            return answer.json().get("reason", ALLOWED)

        there = session == "fleet-cloud"
        assert reason("right") == (ALLOWED if there else "SESSION_NOT_FOUND")
        assert reason("other tenant") == reason("wrong pattern") == "SESSION_NOT_FOUND"
        # Computing needs more than to read.
        assert reason("read only") == "PERMISSION_DENIED"
        assert reason("none") == "CREDENTIALS_MISSING"


def test_health_answers_everybody_and_reflection_by_configuration(site):
    check = site.channel.unary_unary("/grpc.health.v1.Health/Check")
    assert check(b"", timeout=30)


def test_a_revoked_key_ends_watches_and_calls_within_two_seconds(site):
    site.create("fleet-watched")
    made = keys(site.keys_file, "create", "--name", "guest", "--tenant", "ours", "--scope", READ, "--json")
    headers = {"authorization": f"Bearer {made['key']}"}
    path = "/v1/sessions/fleet-watched"
    # The server looks at the file every second.
    waiting = httpx.Client(base_url=site.server.rest_url, timeout=30)
    while waiting.get(path, headers=headers).status_code == 401:
        pass
    with waiting.stream("GET", f"{path}/events", headers=headers, timeout=30) as events:
        assert events.status_code == 200
        keys(site.keys_file, "revoke", made["id"])
        told = "".join(events.iter_text())
    assert "CREDENTIALS_EXPIRED" in told
    assert waiting.get(path, headers=headers).json()["reason"] == "CREDENTIALS_REVOKED"
    waiting.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="files are given away by root alone")
def test_a_file_of_keys_stays_its_owners_when_an_operator_changes_it(tmp_path):
    # Else the server, which is no root, cannot read that a key was taken back.
    file = tmp_path / "keys.json"
    made = keys(file, "create", "--name", "robot-7", "--scope", READ, "--json")
    os.chown(file, 65534, 65534)
    file.chmod(0o640)
    keys(file, "revoke", made["id"])
    found = file.stat()
    assert (found.st_uid, found.st_gid, found.st_mode & 0o777) == (65534, 65534, 0o640)


def test_no_key_and_no_digest_is_in_the_log(site):
    log = site.server.log.read_text()
    assert "CREDENTIALS_MISSING" in log
    assert "audit" in log
    for key in filter(None, site.keys.values()):
        if key.count("_") > 1:
            assert key.split("_", 2)[2] not in log


# zenoh: what a user may put, ask and hear.
ZENOH = {
    # user: (may send, may ask)
    "reader": (False, True),
    "writer": (True, True),
    "stranger": (False, False),
    None: (False, False),
    "wrong password": (False, False),
}
QUESTIONS = ["map/occupancy", "map/cloud", "scene/graph", "scene/objects", "scene/rooms", "sensors", "pose"]


def peer(site: Site, user: str | None):
    """A zenoh session of a user; none if the server lets nobody of that name in."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([site.server.zenoh]))
    config.insert_json5("connect/timeout_ms", "3000")
    config.insert_json5("scouting/multicast/enabled", "false")
    passwords = {"reader": "r", "writer": "w", "stranger": "s", "wrong password": "x"}
    if user:
        name = "writer" if user == "wrong password" else user
        config.insert_json5("transport/auth/usrpwd/user", json.dumps(name))
        config.insert_json5("transport/auth/usrpwd/password", json.dumps(passwords[user]))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None


@pytest.mark.parametrize("user", ZENOH)
def test_every_zenoh_key_answers_each_user_as_the_table_says(site, user):
    may_send, may_ask = ZENOH[user]
    session = f"fleet-zenoh-{(user or 'none').replace(' ', '-')}"
    site.create(session)
    spec = {"spec": {"sensor_id": "o", "kind": "SENSOR_KIND_ODOMETRY"}}
    headers = site.headers("right")
    assert site.http.post(f"/v1/sessions/{session}/sensors", json=spec, headers=headers).status_code == 200
    peer_session = peer(site, user)
    if peer_session is None:
        assert not may_send
        assert not may_ask
        return
    with peer_session:
        for question in QUESTIONS:
            replies = list(peer_session.get(f"percept/{session}/{question}", timeout=5.0))
            assert bool(replies) == may_ask, question
            assert list(peer_session.get(f"percept/depot-x/{question}", timeout=5.0)) == [] or user == "stranger"
        for rpc, may in (
            ("SessionsService/GetPose", may_ask),
            ("LayersService/QueryPoints", may_ask),
            ("SessionsService/UpdateSession", may_send),
            ("SensorsService/SendFrame", may_send),
            ("SessionsService/DeleteSession", False),
        ):
            # Zenoh lets nothing through, and says nothing; what comes through is answered, if by an error.
            replies = list(peer_session.get(f"percept/{session}/rpc/{rpc}", payload=b"", timeout=5.0 if may else 1.0))
            refused = [r.err.payload.to_bytes() for r in replies if r.err]
            assert (
                any(data != b"Timeout" for data in refused) or any(r.ok for r in replies)
                if may
                else (not any(r.ok for r in replies) and set(refused) <= {b"Timeout"})
            ), rpc
            assert not any(r.ok for r in peer_session.get("percept/depot-x/rpc/SessionsService/GetPose", timeout=1.0))
        message = odometry(session)
        message.sensor_id = "o"
        peer_session.put(f"percept/{session}/o/frame", message.SerializeToString())
        if may_ask:
            # Comes after the message on the same link.
            list(peer_session.get(f"percept/{session}/sensors", timeout=5.0))

    def accepted() -> int:
        sensors = site.http.get(f"/v1/sessions/{session}/sensors", headers=headers).json()["sensors"]
        return int(sensors[0]["accepted"])

    if may_send:
        while accepted() == 0:
            pass
    assert (accepted() > 0) == may_send


def test_zenoh_is_not_opened_where_nobody_could_be_known(tmp_path):
    config = tmp_path / "percept.toml"
    keys(tmp_path / "keys.json", "create", "--name", "a", "--scope", READ, "--json")
    config.write_text(f'[auth]\nmode = "required"\nkeys_file = "{tmp_path / "keys.json"}"\n')
    command = [binary(), "serve", "--config", config, "--data-dir", tmp_path / "data", "--grpc", "127.0.0.1:0"]
    command += ["--rest", "127.0.0.1:0", "--zenoh", f"tcp/127.0.0.1:{free_port()}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert "auth.zenoh_users" in done.stderr


def test_listening_beyond_this_machine_asks_for_authentication(tmp_path):
    command = [binary(), "serve", "--data-dir", tmp_path / "data", "--grpc", "0.0.0.0:0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert "auth.allow_anonymous_beyond_loopback" in done.stderr


def test_the_tools_call_with_a_key(site, tmp_path):
    token = tmp_path / "token"
    token.write_text(f"{site.keys['right']}\n")
    drive = [binary(), "sim", "--server", site.server.grpc, "--duration-s", "1", "--sensors", "lidar2d", "--rooms", "1"]
    refused = subprocess.run([*drive, "--session", "fleet-sim"], capture_output=True, text=True, check=False)
    assert refused.returncode != 0
    assert "credentials are missing" in refused.stderr
    done = subprocess.run([*drive, "--session", "fleet-sim", "--token-file", token], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "durable" in done.stdout
