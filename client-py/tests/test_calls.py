"""Deadlines, retries, errors, pages."""

import asyncio
import contextlib
import socket
import threading
import time
import traceback

import grpc
import numpy as np
import pytest
from conftest import refuse

import percept
from percept import AsyncClient, Client, InvalidArgument, NotFound, Unavailable
from percept import _rpc as rpc
from percept.v1 import object_pb2, session_pb2

DEPTH = np.ones((2, 3), np.float32)


def test_an_error_carries_code_reason_field_and_message(fake, client):
    fake.unary(
        rpc.GET_SESSION,
        lambda _, c: refuse(c, grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND", "session_id", "no session x"),
    )
    with pytest.raises(NotFound) as error:
        client.sessions.get("x")
    e = error.value
    assert (e.code, e.reason, e.field) == ("NOT_FOUND", "SESSION_NOT_FOUND", "session_id")
    assert e.message == "no session x"
    assert str(e) == "no session x (field session_id) [SESSION_NOT_FOUND]"


def test_errors_without_details_or_of_other_codes_are_still_ours(fake, client):
    fake.unary(rpc.GET_SESSION, lambda _, c: c.abort(grpc.StatusCode.OUT_OF_RANGE, "far"))
    with pytest.raises(InvalidArgument, match="far"):
        client.sessions.get("x")
    with pytest.raises(percept.PerceptError) as error:
        client.sessions.default_params()
    assert error.value.code == "UNIMPLEMENTED"


def away_at_first(times, answer):
    """Unavailable so many times, then the answer."""
    left = [times]

    def handler(request, context):
        if left[0]:
            left[0] -= 1
            context.abort(grpc.StatusCode.UNAVAILABLE, "stopping")
        return answer

    return handler


def test_a_repeatable_call_is_tried_again_while_the_server_is_away(fake, client):
    fake.unary(rpc.GET_POSE, away_at_first(2, rpc.GET_POSE.answer()))
    assert client.session("s").pose() is None
    assert len(fake.calls) == 3


def test_a_creation_is_repeated_with_the_same_request_id(fake, client):
    answer = rpc.CREATE_SESSION.answer(session=session_pb2.Session(session_id="s"))
    fake.unary(rpc.CREATE_SESSION, away_at_first(1, answer))
    assert client.sessions.create().session_id == "s"
    assert fake.calls[0].request_id == fake.calls[1].request_id != ""


def test_a_frame_whose_answer_was_lost_is_sent_again_and_known_by_its_stamp(fake, client):
    answer = rpc.SEND_FRAME.answer(result=session_pb2.FrameResult(duplicate=True))
    fake.unary(rpc.SEND_FRAME, away_at_first(1, answer))
    assert client.session("s").send_depth("d", stamp_ns=1, depth=DEPTH).duplicate
    assert [call.message.stamp_ns for call in fake.calls] == [1, 1]


def test_a_deletion_is_never_asked_for_twice(fake, client):
    fake.unary(rpc.DELETE_SESSION, away_at_first(1, rpc.DELETE_SESSION.answer()))
    with pytest.raises(Unavailable):
        client.session("s").delete()
    assert len(fake.calls) == 1


def test_sessions_are_listed_by_their_state_with_what_is_wrong_with_them(fake, client):
    fault = {"reason": "RECORD_DAMAGED", "message": "a record does not parse"}
    listed = session_pb2.Session(session_id="s", state=session_pb2.SESSION_STATE_FAULTED, fault=fault)
    fake.unary(rpc.LIST_SESSIONS, lambda *_: rpc.LIST_SESSIONS.answer(sessions=[listed]))
    [info] = client.sessions.list(state="faulted")
    assert fake.calls[0].state == session_pb2.SESSION_STATE_FAULTED
    assert (info.state, info.fault) == ("faulted", percept.SessionFault(**fault))
    assert (info.params, info.pose, info.last_stamp_ns) == (None, None, None)


def test_the_deadline_bounds_a_call(fake):
    def slow(request, context):
        time.sleep(1)
        return rpc.GET_POSE.answer()

    fake.unary(rpc.GET_POSE, slow)
    with Client(fake.address, timeout_s=0.1) as client, pytest.raises(percept.DeadlineExceeded):
        client.session("s").pose()


def test_nobody_at_the_address_is_unavailable_and_not_healthy():
    with Client("127.0.0.1:1", timeout_s=1.0, retries=1) as client:
        assert client.with_options(timeout_s=0.3).health() is False
        with pytest.raises(Unavailable):
            client.session("s").pose()


@pytest.mark.parametrize("address", [None, 50051, [50051], b"127.0.0.1:50051"])
def test_an_address_that_is_no_text_is_told(address):
    with pytest.raises(
        percept.WrongType, match=r"address is .*; give host:port, e\.g\. '127\.0\.0\.1:50051'"
    ):
        Client(address)


def test_sessions_and_sensors_of_other_types_are_told(client):
    with pytest.raises(percept.WrongType, match="session_id is 7; give its id"):
        client.session(7)
    with pytest.raises(percept.WrongType, match="session_id is 7; give an id"):
        client.sessions.create(7)
    laser = percept.SensorSpec("laser", kind="lidar2d")
    for sensors in (laser, [{"sensor_id": "laser", "kind": "lidar2d"}], ["laser"]):
        with pytest.raises(percept.WrongType, match=r"sensors is .*; give a list of SensorSpec"):
            client.sessions.create(sensors=sensors)


def test_pages_say_how_they_are_read(client):
    assert (
        repr(client.sessions.list()) == "<Pages: asked for as they are used in a loop; .all() gives a list>"
    )


@contextlib.contextmanager
def somebody_who_hangs_up():
    """The address of a server that is there, and speaks something else than gRPC."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def hang_up():
            with contextlib.suppress(OSError):
                while True:
                    server.accept()[0].close()

        threading.Thread(target=hang_up, daemon=True).start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)


def test_who_cannot_be_reached_is_named_with_what_to_look_at():
    said = {}
    with somebody_who_hangs_up() as other:
        for address in ("127.0.0.1:1", other, "no-such-host.invalid:50051"):
            with Client(address, timeout_s=3.0, retries=0) as client, pytest.raises(Unavailable) as error:
                client.session("s").pose()
            assert (error.value.reason, error.value.code) == ("SERVER_UNREACHABLE", "UNAVAILABLE")
            assert error.value.message.startswith(f"cannot reach {address}: ")
            said[address] = error.value.message
    assert "nobody listens there; is `percept serve` running" in said["127.0.0.1:1"]
    assert "than gRPC's (50051; REST has 8080)" in said[other]
    assert "no machine of this name" in said["no-such-host.invalid:50051"]


def test_tls_where_none_is_spoken_says_so(fake):
    meant = pytest.raises(Unavailable, match="the TLS handshake failed; a server without TLS is called by")
    with Client(f"https://{fake.address}", timeout_s=3.0, retries=0) as client, meant:
        client.session("s").pose()


def test_no_answer_in_time_names_the_server_and_the_option(fake):
    done = threading.Event()
    fake.unary(rpc.GET_POSE, lambda *_: done.wait(20) and rpc.GET_POSE.answer())
    try:
        with Client(fake.address, timeout_s=0.2) as client, pytest.raises(percept.DeadlineExceeded) as error:
            client.session("s").pose()
        assert str(error.value).startswith(f"{fake.address} did not answer in time; give the call more ")
    finally:
        done.set()


def test_a_traceback_tells_what_percept_says_and_not_the_insides_of_grpc(fake, client):
    fake.unary(
        rpc.GET_POSE,
        lambda _, c: refuse(c, grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND", "session_id", "no session s"),
    )
    with pytest.raises(NotFound) as error:
        client.session("s").pose()
    shown = "".join(traceback.format_exception(error.value))
    assert "no session s (field session_id) [SESSION_NOT_FOUND]" in shown
    assert "RpcError" not in shown
    assert "debug_error_string" not in shown
    # Whoever looks for it finds it.
    assert isinstance(error.value.__context__, grpc.RpcError)


def refused_at_first(times, code, answer, **details):
    """Refused so many times, then the answer."""
    left = [times]

    def handler(request, context):
        if left[0]:
            left[0] -= 1
            refuse(context, code, "BUSY", "", **details)
        return answer

    return handler


def test_a_limit_is_waited_for_if_the_server_says_for_how_long(fake, client):
    exhausted, answer = grpc.StatusCode.RESOURCE_EXHAUSTED, rpc.GET_POSE.answer()
    fake.unary(rpc.GET_POSE, refused_at_first(2, exhausted, answer, retry_s=0.05))
    assert client.session("s").pose() is None
    assert len(fake.calls) == 3
    # Without that it is used up, and a further try would find it so, too.
    fake.unary(rpc.GET_POSE, refused_at_first(1, exhausted, answer))
    with pytest.raises(percept.ResourceExhausted) as error:
        client.session("s").pose()
    assert error.value.retry_after_s is None
    assert len(fake.calls) == 4


def test_a_pause_beyond_the_deadline_is_left_to_the_caller(fake, client):
    fake.unary(
        rpc.GET_POSE,
        refused_at_first(1, grpc.StatusCode.UNAVAILABLE, rpc.GET_POSE.answer(), retry_s=3600),
    )
    with pytest.raises(Unavailable) as error:
        client.session("s").pose()
    assert error.value.retry_after_s == 3600
    assert len(fake.calls) == 1


def test_what_may_not_be_repeated_is_not_whatever_the_server_asks_for(fake, client):
    code, answer = grpc.StatusCode.RESOURCE_EXHAUSTED, rpc.UPLOAD_CLOUD.answer()
    fake.unary(rpc.UPLOAD_CLOUD, refused_at_first(1, code, answer, retry_s=0.01))
    with pytest.raises(percept.ResourceExhausted) as error:
        client.toolbox.upload_cloud(b"ply")
    assert error.value.retry_after_s == 0.01


def test_who_may_not_is_told_so_and_the_trace_for_the_operator(fake, client):
    for code, kind in (
        (grpc.StatusCode.UNAUTHENTICATED, percept.Unauthenticated),
        (grpc.StatusCode.PERMISSION_DENIED, percept.PermissionDenied),
    ):
        fake.unary(
            rpc.GET_POSE, refused_at_first(1, code, rpc.GET_POSE.answer(), metadata={"trace_id": "4bf9"})
        )
        with pytest.raises(kind) as error:
            client.session("s").pose()
        assert (error.value.code, error.value.reason, error.value.trace_id) == (code.name, "BUSY", "4bf9")
    assert issubclass(percept.PermissionDenied, PermissionError)


def test_options_hold_for_what_was_made_with_them_and_for_nothing_else(fake, client):
    fake.unary(rpc.GET_POSE, lambda *_: rpc.GET_POSE.answer())
    fake.unary(rpc.GET_OBJECT, lambda *_: rpc.GET_OBJECT.answer())
    session = client.session("s")
    mine = session.with_options(metadata={"X-Request-Id": "1"})
    mine.pose()
    mine.scene.with_options(metadata={"x-request-id": "2", "x-b": "3"}).object(1)
    client.with_options(metadata={"x-b": "4"}).session("s").pose()
    session.pose()
    ids = [(h.get("x-request-id"), h.get("x-b")) for h in fake.headers]
    assert ids == [("1", None), ("2", "3"), (None, "4"), (None, None)]


def test_a_header_takes_the_place_of_the_one_before_however_its_name_is_written(fake, client):
    sent = []

    def answer(request, context):
        sent.append([v for k, v in context.invocation_metadata() if k == "x-request-id"])
        return rpc.GET_POSE.answer()

    fake.unary(rpc.GET_POSE, answer)
    first = client.with_options(metadata={"X-Request-Id": "1"})
    first.with_options(metadata={"X-Request-Id": "2"}).session("s").pose()
    first.with_options(metadata={"X-REQUEST-ID": "3"}).session("s").pose()
    client.with_options(metadata={"x-request-id": "4", "X-Request-Id": "5"}).session("s").pose()
    assert sent == [["2"], ["3"], ["5"]]


@pytest.mark.parametrize(
    "metadata", [{"two words": "1"}, {"x": "a\nb"}, {"x": b"\xff"}, {"": "1"}, {"x": "é"}]
)
def test_a_header_that_cannot_be_sent_is_refused_where_it_is_given(client, metadata):
    for give in (client.with_options, lambda **options: Client("127.0.0.1:1", **options)):
        with pytest.raises(InvalidArgument) as error:
            give(metadata=metadata)
        assert (error.value.reason, error.value.field) == ("METADATA_INVALID", "metadata")
    client.with_options(metadata={"x-bin": b"\xff\x00", "x": "a b"})


def test_a_session_with_less_patience_shares_the_link(fake, client):
    release = threading.Event()

    def slow(request, context):
        release.wait(10)
        return rpc.GET_POSE.answer()

    fake.unary(rpc.GET_POSE, slow)
    session = client.session("s")
    with pytest.raises(percept.DeadlineExceeded):
        session.with_options(timeout_s=0.1).pose()
    release.set()
    assert session.pose() is None


def test_a_try_less_is_a_try_less(fake, client):
    fake.unary(rpc.GET_POSE, away_at_first(1, rpc.GET_POSE.answer()))
    with pytest.raises(Unavailable):
        client.session("s").with_options(retries=0).pose()
    assert len(fake.calls) == 1


def paged(request, context):
    first = int(request.page_token or 0)
    numbers = range(first, min(first + request.page_size, 7))
    token = str(numbers.stop) if numbers.stop < 7 else ""
    objects = [object_pb2.Object(object_id=i) for i in numbers]
    return rpc.LIST_OBJECTS.answer(objects=objects, next_page_token=token)


def test_pages_are_followed_as_they_are_used(fake, client):
    fake.unary(rpc.LIST_OBJECTS, paged)
    objects = client.session("s").scene.objects(page_size=3)
    assert next(objects).object_id == 0
    assert len(fake.calls) == 1
    assert [o.object_id for o in objects] == [1, 2, 3, 4, 5, 6]
    assert len(fake.calls) == 3


def test_chunks_of_a_trajectory_are_joined(fake, client):
    def chunks(request, context):
        for i in range(3):
            pose = session_pb2.TrajectoryPose(stamp_ns=i, state=session_pb2.TRACKING_STATE_TRACKING)
            pose.t_map_base.translation.x = i
            yield rpc.GET_TRAJECTORY.answer(map_version=4, poses=[pose])

    fake.streaming(rpc.GET_TRAJECTORY, chunks)
    trajectory = client.session("s").trajectory()
    assert trajectory.stamps_ns.tolist() == [0, 1, 2]
    assert trajectory.t_map_base.shape == (3, 4, 4)
    assert trajectory.t_map_base[2, 0, 3] == 2
    assert trajectory.length_m == pytest.approx(2)
    assert trajectory.states == ("tracking",) * 3


def test_asyncio_does_the_same(fake):
    fake.unary(rpc.LIST_OBJECTS, paged)
    fake.unary(rpc.GET_POSE, away_at_first(1, rpc.GET_POSE.answer()))
    fake.unary(
        rpc.GET_OBJECT, lambda _, c: refuse(c, grpc.StatusCode.NOT_FOUND, "OBJECT_NOT_FOUND", "object_id")
    )

    async def scenario():
        async with AsyncClient(fake.address, timeout_s=5.0) as client:
            session = client.session("s")
            assert await session.pose() is None
            assert [o.object_id async for o in session.scene.objects(page_size=4)] == list(range(7))
            with pytest.raises(NotFound) as error:
                await session.scene.object(3)
            assert error.value.reason == "OBJECT_NOT_FOUND"
            assert await client.health() is False

    asyncio.run(scenario())
