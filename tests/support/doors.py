"""Three doors behind one face, for behaviours that must be alike at all of them."""

from __future__ import annotations

import json
from dataclasses import dataclass

import grpc
import httpx
import percept.zenoh
from google.protobuf import json_format
from percept import Client, OccupancyGrid, PerceptError, PoseEstimate, _rpc, errors
from percept._convert import maps, poses
from percept.v1 import maps_service_pb2, sensor_pb2, sensors_service_pb2, sessions_service_pb2

from .server import Server, eventually


@dataclass(frozen=True)
class Outcome:
    """What became of a message. Where a door cannot tell why (zenoh), the reason is None."""

    accepted: bool
    reason: str | None = None
    field: str | None = None
    code: str | None = None


class GrpcDoor:
    name = "grpc"
    tells_why = True

    def __init__(self, server: Server, client: Client) -> None:
        self._channel = grpc.insecure_channel(server.grpc)
        self._client = client
        self._send = self._channel.unary_unary(
            _rpc.SEND_FRAME.path,
            request_serializer=sensors_service_pb2.SendFrameRequest.SerializeToString,
            response_deserializer=sensors_service_pb2.SendFrameResponse.FromString,
        )

    def send(self, message: sensor_pb2.SensorMessage) -> Outcome:
        try:
            self._send(sensors_service_pb2.SendFrameRequest(message=message), timeout=30)
        except grpc.RpcError as cause:
            e = errors.error_of_rpc(cause)
            return Outcome(False, e.reason, e.field, e.code)
        return Outcome(True)

    def pose(self, session_id: str) -> PoseEstimate | None:
        return self._client.session(session_id).pose()

    def grid(self, session_id: str) -> OccupancyGrid:
        return self._client.session(session_id).map.occupancy()

    def close(self) -> None:
        self._channel.close()


class RestDoor:
    name = "rest"
    tells_why = True

    def __init__(self, server: Server, client: Client) -> None:
        self.http = httpx.Client(base_url=server.rest_url, timeout=30)

    def send(self, message: sensor_pb2.SensorMessage) -> Outcome:
        request = sensors_service_pb2.SendFrameRequest(message=message)
        body = json_format.MessageToDict(request, preserving_proto_field_name=True)
        session_id = message.session_id or "-"
        response = self.http.post(f"/v1/sessions/{session_id}/frames", content=json.dumps(body), headers=JSON)
        if response.status_code == 200:
            return Outcome(True)
        return self._refused(response)

    def pose(self, session_id: str) -> PoseEstimate | None:
        answer = self._get(f"/v1/sessions/{session_id}/pose", sessions_service_pb2.GetPoseResponse())
        return poses.pose_estimate(answer.pose) if answer.HasField("pose") else None

    def grid(self, session_id: str) -> OccupancyGrid:
        path = f"/v1/sessions/{session_id}/map/occupancy"
        answer = self._get(path, maps_service_pb2.GetOccupancyGridResponse())
        return maps.occupancy([answer.chunk])

    def close(self) -> None:
        self.http.close()

    def _get(self, path, message):
        response = self.http.get(path)
        assert response.status_code == 200, response.text
        return json_format.ParseDict(response.json(), message)

    @staticmethod
    def _refused(response: httpx.Response) -> Outcome:
        assert response.headers["content-type"].startswith("application/problem+json"), response.text
        problem = response.json()
        assert problem["status"] == response.status_code
        assert problem["detail"]
        return Outcome(False, problem["reason"], problem["field"], problem["code"])


JSON = {"content-type": "application/json"}


class ZenohDoor:
    """zenoh does not answer: what became of a message is read off the sensor's counters."""

    name = "zenoh"
    tells_why = False

    def __init__(self, server: Server, client: Client) -> None:
        self._endpoint = server.zenoh
        self._client = client
        self._publishers: dict[str, percept.zenoh.SensorPublisher] = {}
        self._readers: dict[str, percept.zenoh.MapReader] = {}

    def send(self, message: sensor_pb2.SensorMessage) -> Outcome:
        session_id = message.session_id
        publisher = self._publishers.get(session_id)
        if publisher is None:
            publisher = percept.zenoh.SensorPublisher(self._endpoint, session_id=session_id)
            self._publishers[session_id] = publisher
        before = self._counts(session_id, message.sensor_id)
        publisher.publish_raw(message.sensor_id, message.SerializeToString())
        if before is None:
            return Outcome(False)

        def moved() -> bool:
            return self._counts(session_id, message.sensor_id) != before

        assert eventually(moved), "the message was neither accepted nor refused"
        after = self._counts(session_id, message.sensor_id)
        assert sum(after) == sum(before) + 1
        return Outcome(after[0] > before[0])

    def pose(self, session_id: str) -> PoseEstimate | None:
        return self._reader(session_id).pose()

    def grid(self, session_id: str) -> OccupancyGrid:
        return self._reader(session_id).occupancy()

    def close(self) -> None:
        for peer in [*self._publishers.values(), *self._readers.values()]:
            peer.close()

    def _reader(self, session_id: str) -> percept.zenoh.MapReader:
        if session_id not in self._readers:
            self._readers[session_id] = percept.zenoh.MapReader(self._endpoint, session_id=session_id)
        return self._readers[session_id]

    def _counts(self, session_id: str, sensor_id: str) -> tuple[int, int] | None:
        try:
            sensors = self._client.session(session_id).sensors.list()
        except PerceptError:
            return None
        found = [s for s in sensors if s.spec.sensor_id == sensor_id]
        return (found[0].accepted, found[0].rejected) if found else None


DOORS = {door.name: door for door in (GrpcDoor, RestDoor, ZenohDoor)}
