"""Operations: work that goes on whoever hangs up, with progress and cancel."""

from __future__ import annotations

import asyncio
import hashlib
import json
import subprocess

import httpx
import numpy as np
import pytest
from percept import (
    AsyncClient,
    Client,
    DeadlineExceeded,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    ResourceExhausted,
    Step,
)

from support import world
from support.prometheus import Metrics
from support.raw import Calls, answer_of
from support.server import Server, binary, eventually

#: A step that takes its time, and leaves the points as they are.
NORMALS = Step("estimate_normals", radius_m=0.5, max_neighbours=60, quiet=True)
#: The most that a pipeline may have; nobody waits for their end.
ENDLESS = [NORMALS] * 64


def hills(n: int = 300_000) -> np.ndarray:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-5, 5, (2, n))
    return np.column_stack([x, y, np.sin(x) + rng.normal(0, 0.01, n)]).astype(np.float32)


@pytest.fixture(scope="module")
def kept(client):
    handle = client.toolbox.upload_cloud(hills(60_000))
    yield handle
    client.toolbox.drop_cloud(handle)


def without_times(result):
    """What a pipeline found, without how long it took."""
    steps = [(s.operation, s.num_points_in, s.num_points_out, s.answer) for s in result.steps]
    return steps, result.cloud


def begun(operation):
    """Waits until some of the work is done."""
    for info in operation.watch(every_s=0.01):
        assert not info.has_ended, "it was meant to take long; give it more to do"
        if info.fraction:
            return info
    raise AssertionError("unreachable")


STEPS = [
    Step("downsample_voxels", voxel_size_m=0.1),
    Step("segment_planes", max_planes=2, remainder="rest"),
    Step("cluster_points", eps_m=0.3),
    Step("compute_shape_features"),
]


def test_work_goes_on_when_its_starter_hangs_up_and_another_connection_reads_what_came_of_it(server, kept):
    with Client(server.grpc) as first:
        started = first.toolbox.start_pipeline(kept, [NORMALS, *STEPS], send_cloud=True)
        assert not started.info.has_ended
    with Client(server.grpc) as second:
        found = second.operations.get(started.operation_id)
        result = found.result(timeout_s=60)
        assert (found.info.kind, found.info.state) == ("run_pipeline", "done")
        plain = second.toolbox.run_pipeline(kept, [NORMALS, *STEPS], send_cloud=True)
        assert without_times(result) == without_times(plain)
        # It may be read again, until it is deleted.
        assert without_times(found.result()) == without_times(plain)
        assert found.operation_id in [o.operation_id for o in second.operations.list(state="done")]
        found.delete()
        with pytest.raises(NotFound) as error:
            found.refresh()
        assert (error.value.reason, error.value.field) == ("OPERATION_NOT_FOUND", "operation_id")
        assert "stopped" in error.value.message


@pytest.mark.parametrize("file_format", ["cloud_ply", "cloud_pcd", "trajectory_tum", "nav2_pgm", "overview_png"])
def test_an_exported_file_is_the_plain_calls(laser_session, client, file_format):
    operation = laser_session.map.start_export(file_format)
    file = operation.result(timeout_s=60)
    assert file == laser_session.map.export(file_format)
    info = operation.info
    assert (info.kind, info.session_id) == ("export_map", laser_session.session_id)
    assert info.result_size_bytes >= len(file.data)
    assert info.create_time_ns <= info.run_time_ns <= info.end_time_ns < info.expire_time_ns
    listed = client.operations.list(session_pattern=laser_session.session_id[:-1] + "*")
    assert operation.operation_id in [o.operation_id for o in listed]
    assert operation.operation_id not in [o.operation_id for o in client.operations.list(session_pattern="none-*")]


def test_a_map_is_optimised_as_by_the_plain_call(client):
    session = client.sessions.create(sensors=[world.LASER])
    for i, pose in enumerate(world.drive(8)):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    done = session.map.start_optimise().result(timeout_s=60)
    assert done.map_version == session.map.summary().stamp.map_version
    # All that waited was made: there is nothing left for the plain call.
    assert session.map.optimise().num_keyframes_moved == 0
    session.delete()


def test_a_global_registration_is_the_plain_calls(client):
    pose = world.drive(1)[0]
    source, target = world.cloud(pose), world.cloud(pose)
    operation = client.toolbox.start_register_clouds_globally(source, target=target, voxel_size_m=0.1)
    assert operation.result(timeout_s=120) == client.toolbox.register_clouds_globally(
        source, target=target, voxel_size_m=0.1
    )
    assert operation.info.fraction == 1
    assert operation.info.stage.endswith("register_clouds_globally")


def test_progress_is_that_of_the_steps_and_grows(client, kept):
    operation = client.toolbox.start_pipeline(kept, [NORMALS] * 12)
    seen = [info for info in operation.watch(every_s=0.01) if info.fraction is not None]
    shares = [info.fraction for info in seen]
    assert shares == sorted(shares)
    assert len(set(shares)) > 3
    assert all(round(share * 12) == pytest.approx(share * 12) for share in shares)
    assert (shares[-1], seen[-1].state) == (1, "done")
    for info in seen[:-1]:
        step = round(info.fraction * 12) + 1
        assert info.stage == f"step {min(step, 12)} of 12: estimate_normals"


def test_what_is_cancelled_ends_and_leaves_its_place_to_the_next(own_server):
    with Client(own_server.grpc) as client:
        cloud = client.toolbox.upload_cloud(hills())
        running = client.toolbox.start_pipeline(cloud, ENDLESS)
        begun(running)
        # One of an owner runs at a time, by default.
        waiting, last = (client.toolbox.start_pipeline(cloud, STEPS) for _ in range(2))
        assert waiting.info.state == last.info.state == "queued"
        assert waiting.cancel().state == "cancelled", "what has not begun is ended at once"
        assert running.cancel().cancel_requested
        ended = running.wait(60)
        assert (ended.state, ended.fault.reason) == ("cancelled", "OPERATION_CANCELLED")
        assert ended.fraction < 1
        for operation in (waiting, running):
            with pytest.raises(FailedPrecondition) as error:
                operation.result()
            assert error.value.reason == "OPERATION_CANCELLED"
        assert last.wait(60).state == "done"
        assert eventually(lambda: Metrics(own_server.rest_url).sum("percept_compute_running") == 0)
        metrics = Metrics(own_server.rest_url)
        assert metrics.sum("percept_compute_waiting") == 0
        for state, count in {"cancelled": 2, "done": 1}.items():
            assert metrics.sum("percept_operations", state=state) == count
            assert metrics.sum("percept_operations_ended_total", kind="run_pipeline", state=state) == count
        # Cancelling what has ended changes nothing.
        assert last.cancel().state == "done"


def test_questions_are_answered_while_an_operation_runs(own_server):
    with Client(own_server.grpc) as client:
        cloud = client.toolbox.upload_cloud(hills())
        running = client.toolbox.start_pipeline(cloud, ENDLESS)
        begun(running)
        assert client.toolbox.downsample_voxels(cloud, voxel_size_m=1.0).num_points > 10
        assert not running.refresh().has_ended
        running.cancel()


def test_a_request_id_names_one_operation(client, kept):
    first = client.toolbox.start_pipeline(kept, STEPS, request_id="once-only")
    again = client.toolbox.start_pipeline(kept, STEPS, request_id="once-only")
    assert first.operation_id == again.operation_id
    assert again.info.request_id == "once-only"
    assert client.toolbox.start_pipeline(kept, STEPS).operation_id != first.operation_id
    first.wait(60)
    first.delete()
    later = client.toolbox.start_pipeline(kept, STEPS, request_id="once-only")
    assert later.operation_id != first.operation_id
    later.wait(60)


def test_waiting_ends_with_the_callers_patience_and_never_in_an_error(own_server):
    with Client(own_server.grpc) as client, Calls(own_server.grpc) as calls:
        running = client.toolbox.start_pipeline(hills(), ENDLESS)
        assert not running.wait(0.05).has_ended
        # Shorter than what is asked for: how it stands is answered before the call's deadline.
        waited = calls("OperationsService/WaitOperation", 2.0, operation_id=running.operation_id)
        assert waited.ok, waited
        assert waited.message.operation.operation_id == running.operation_id
        with pytest.raises(DeadlineExceeded) as error:
            running.result(timeout_s=0.05)
        assert error.value.reason == "OPERATION_NOT_DONE"
        running.cancel()


def test_bad_requests_are_refused_at_once_or_told_by_the_operation(client, server, laser_session, kept):
    url = f"{server.rest_url}/v1/operations"

    def refused(answer):
        problem = answer.json()
        return answer.status_code, problem["reason"], problem["field"]

    session = {"source": {"session_id": laser_session.session_id}}
    nowhere = {"source": {"session_id": "none"}}
    pipeline = {"cloud": {"session": {"session_id": "none"}}, "steps": [{"downsample_voxels": {}}]}
    for body, expected in [
        ({}, (400, "FIELD_MISSING", "work")),
        ({"optimise_map": {}}, (400, "FIELD_MISSING", "optimise_map.source")),
        ({"export_map": session}, (400, "ENUM_UNKNOWN", "export_map.format")),
        ({"optimise_map": nowhere}, (404, "SESSION_NOT_FOUND", "optimise_map.session_id")),
        ({"run_pipeline": pipeline}, (404, "SESSION_NOT_FOUND", "run_pipeline.cloud.session.session_id")),
        ({"optimise_map": session, "request_id": "a/b"}, (400, "ID_INVALID", "request_id")),
    ]:
        assert refused(httpx.post(url, json=body)) == expected
    both = httpx.post(url, json={"optimise_map": session, "export_map": session})
    assert refused(both)[:2] == (400, "JSON_INVALID")
    for method, path in [
        ("GET", "/op-0"),
        ("GET", "/op-0/wait"),
        ("GET", "/op-0/result"),
        ("POST", "/op-0/cancel"),
        ("DELETE", "/op-0"),
    ]:
        sent = {"json": {}} if method == "POST" else {}
        assert refused(httpx.request(method, url + path, **sent)) == (
            404,
            "OPERATION_NOT_FOUND",
            "operation_id",
        )
    assert refused(httpx.get(url, params={"page_token": "x"})) == (400, "PAGE_TOKEN_INVALID", "page_token")
    assert refused(httpx.get(url, params={"session_pattern": "?"})) == (
        400,
        "PATTERN_INVALID",
        "session_pattern",
    )
    # What only computing finds out is the operation's error, in the words of the plain call.
    wrong = [Step("downsample_voxels", voxel_size_m=-1.0)]
    failed = client.toolbox.start_pipeline(kept, wrong)
    with pytest.raises(InvalidArgument) as plain:
        client.toolbox.run_pipeline(kept, wrong)
    with pytest.raises(InvalidArgument) as told:
        failed.result(timeout_s=60)
    assert (told.value.reason, told.value.field, told.value.message) == (
        plain.value.reason,
        plain.value.field,
        plain.value.message,
    )
    assert failed.info.state == "failed"
    waiting = httpx.get(f"{url}/{failed.operation_id}/wait", params={"timeout_s": -1})
    assert refused(waiting) == (400, "OUT_OF_RANGE", "timeout_s")
    answer = httpx.get(f"{url}/{failed.operation_id}/result")
    assert (answer.status_code, answer.json()["reason"]) == (400, plain.value.reason)


def test_what_runs_has_no_result_yet_and_is_not_deleted(own_server):
    with Client(own_server.grpc) as client:
        running = client.toolbox.start_pipeline(hills(), ENDLESS)
        with pytest.raises(FailedPrecondition) as error:
            running.delete()
        assert error.value.reason == "OPERATION_UNDER_WAY"
        answer = httpx.get(f"{own_server.rest_url}/v1/operations/{running.operation_id}/result")
        assert (answer.status_code, answer.json()["reason"]) == (409, "OPERATION_NOT_DONE")
        running.cancel()


def test_rest_has_a_files_result_as_a_download_and_others_as_messages(server, laser_session):
    url = f"{server.rest_url}/v1/operations"
    source = {"session_id": laser_session.session_id}
    started = httpx.post(url, json={"export_map": {"source": source, "format": "MAP_FORMAT_CLOUD_PLY"}})
    operation = started.json()["operation"]["operation_id"]
    assert httpx.get(f"{url}/{operation}/wait", timeout=70).json()["operation"]["state"] == "OPERATION_STATE_DONE"
    plain = laser_session.map.export("cloud_ply").data
    file = httpx.get(f"{url}/{operation}/result")
    assert file.content == plain
    assert file.headers["etag"] == f'"{hashlib.sha256(plain).hexdigest()}"'
    assert f'{laser_session.session_id}.ply"' in file.headers["content-disposition"]
    part = httpx.get(f"{url}/{operation}/result", headers={"range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, plain[100:200])
    message = httpx.get(f"{url}/{operation}/result", headers={"accept": "application/json"}).json()
    assert message["export_map"]["chunk"]["header"]["size_bytes"] == str(len(plain))
    assert httpx.delete(f"{url}/{operation}").status_code == 200

    started = httpx.post(url, json={"optimise_map": {"source": source}}).json()
    operation = started["operation"]["operation_id"]
    httpx.get(f"{url}/{operation}/wait", timeout=70)
    result = httpx.get(f"{url}/{operation}/result").json()
    assert result["optimise_map"]["num_keyframes_moved"] == "0"


def test_a_list_comes_in_pages_oldest_first(own_server):
    with Client(own_server.grpc) as client:
        cloud = client.toolbox.upload_cloud(hills(1000))
        ids = [client.toolbox.start_pipeline(cloud, STEPS).operation_id for _ in range(5)]
        assert [o.operation_id for o in client.operations.list(page_size=2)] == ids


def create_key(file, name, tenant, scope, sessions="fleet-*"):
    command = [
        binary(),
        "keys",
        "create",
        "--file",
        file,
        "--name",
        name,
        "--tenant",
        tenant,
        "--scope",
        scope,
    ]
    done = subprocess.run([*command, "--sessions", sessions, "--json"], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)["key"]


@pytest.fixture
def site(tmp_path):
    """A server that asks who calls, and a client of each of some callers."""
    file = tmp_path / "keys.json"
    callers = {
        "owner": ("ours", "write", "fleet-*"),
        "colleague": ("ours", "admin", "fleet-*"),
        "reader": ("ours", "read", "fleet-*"),
        "stranger": ("theirs", "admin", "*"),
        "elsewhere": ("ours", "write", "depot-*"),
    }
    keys = {name: create_key(file, name, *rest) for name, rest in callers.items()}
    users = tmp_path / "users"
    users.write_text("nobody:n\n")
    config = tmp_path / "percept.toml"
    config.write_text(
        f'[auth]\nmode = "required"\nkeys_file = "{file}"\nzenoh_users_file = "{users}"\n'
        '[[auth.zenoh_users]]\nuser = "nobody"\ntenant = "ours"\naccess = "read"\nsessions = "zenoh-*"\n'
    )
    server = Server(tmp_path / "data", "--config", str(config))
    clients = {name: Client(server.grpc, token=key) for name, key in keys.items()}
    yield clients
    for client in clients.values():
        client.close()
    server.kill()


def test_an_operation_is_its_starters_alone(site):
    session = site["owner"].sessions.create("fleet-1", sensors=[world.LASER])
    session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    operation = session.map.start_export("trajectory_tum")
    operation.result(timeout_s=60)
    for name in ("colleague", "reader", "stranger", "elsewhere"):
        other = site[name]
        assert list(other.operations.list()) == []
        for ask in ("refresh", "wait", "cancel", "result", "delete"):
            theirs = type(operation)(other._transport, operation.info)
            with pytest.raises(NotFound) as error:
                getattr(theirs, ask)()
            assert error.value.reason == "OPERATION_NOT_FOUND"
    assert operation.refresh().state == "done"


def test_starting_needs_the_access_of_the_plain_call(site):
    session = site["owner"].sessions.create("fleet-1", sensors=[world.LASER])
    session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    reader = site["reader"]
    assert reader.session("fleet-1").map.start_export("trajectory_tum").result(timeout_s=60).data
    for start in (
        reader.session("fleet-1").map.start_optimise,
        lambda: reader.toolbox.start_pipeline(hills(100), STEPS),
        lambda: reader.toolbox.start_register_clouds_globally(hills(100), target=hills(100)),
    ):
        with pytest.raises(PermissionDenied):
            start()
    for name in ("stranger", "elsewhere"):
        theirs = site[name].session("fleet-1").map
        for start in (theirs.start_optimise, lambda m=theirs: m.start_export("cloud_ply")):
            with pytest.raises(NotFound) as error:
                start()
            assert error.value.reason == "SESSION_NOT_FOUND"


@pytest.fixture
def small_server(tmp_path, monkeypatch):
    """A server that keeps few operations, for a short time."""
    for name, value in {
        "MAX_OPERATIONS_PER_OWNER": 3,
        "MAX_OPERATION_BYTES_PER_OWNER": 200_000,
        "OPERATION_KEPT_S": 5,
    }.items():
        monkeypatch.setenv(f"PERCEPT_LIMITS_{name}", str(value))
    server = Server(tmp_path / "data")
    yield server
    server.kill()


def test_number_memory_and_time_are_bounded(small_server):
    with Client(small_server.grpc, retries=0) as client:
        large = client.toolbox.upload_cloud(hills(20_000))
        with pytest.raises(ResourceExhausted) as error:
            client.toolbox.start_pipeline(hills(20_000), STEPS)
        assert error.value.reason == "OPERATIONS_FULL"
        # 240 kB as a result do not fit either.
        failed = client.toolbox.start_pipeline(large, [Step("remove_non_finite", quiet=True)], send_cloud=True)
        assert failed.wait(60).fault.reason == "OPERATIONS_FULL"
        small = [Step("downsample_voxels", voxel_size_m=1.0)]
        others = [client.toolbox.start_pipeline(large, small) for _ in range(2)]
        with pytest.raises(ResourceExhausted) as error:
            client.toolbox.start_pipeline(large, small)
        assert error.value.reason == "TOO_MANY_OPERATIONS"
        failed.delete()
        third = client.toolbox.start_pipeline(large, small)
        for operation in (*others, third):
            assert operation.wait(60).state == "done"
        # Their time is over by themselves.
        assert eventually(lambda: not list(client.operations.list()), seconds=30)
        with pytest.raises(NotFound):
            third.refresh()


def test_a_server_that_stops_ends_its_operations_and_knows_them_no_more(tmp_path):
    server = Server(tmp_path / "data")
    with Client(server.grpc) as client, Calls(server.grpc) as calls:
        running = client.toolbox.start_pipeline(hills(), ENDLESS)
        waiting = calls.begin("OperationsService/WaitOperation", 60, operation_id=running.operation_id)
        begun(running)
        assert server.stop() == 0
        told = answer_of(waiting)
        assert (told.code, told.reason) == ("UNAVAILABLE", "STOPPING")
    server.start()
    with Client(server.grpc) as client, pytest.raises(NotFound) as error:
        client.operations.get(running.operation_id)
    assert error.value.reason == "OPERATION_NOT_FOUND"
    server.kill()


def test_asyncio_does_the_same(server, kept):
    async def scenario():
        async with AsyncClient(server.grpc) as client:
            operation = await client.toolbox.start_pipeline(kept, STEPS)
            states = [info.state async for info in operation.watch(every_s=0.05)]
            found = await client.operations.get(operation.operation_id)
            return states, await found.result(), await client.toolbox.run_pipeline(kept, STEPS)

    states, result, plain = asyncio.run(scenario())
    assert states[-1] == "done"
    assert without_times(result) == without_times(plain)
