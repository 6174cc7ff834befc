"""Objects and the scene graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import _rpc
from .._call import Call, PagedCall
from ..types.geometry import OrientedBox
from ..types.scene import (
    Detection,
    Door,
    Object,
    ObjectAnnotation,
    ObjectChange,
    ObjectChangeKind,
    ObjectClass,
    ObjectClassInfo,
    ObjectState,
    PastObjectState,
    Place,
    PlaceLink,
    Relation,
    RelationFilter,
    RelationFrame,
    RelationKind,
    Room,
    RoomKind,
    Rooms,
    SceneGraph,
    SceneNode,
    SceneNodeKind,
    ShapeFeatures,
)
from ..v1 import object_pb2, scene_pb2
from ..v1 import scene_service_pb2 as service
from . import geometry, words


def class_to(field: str, object_class: ObjectClass | str) -> object_pb2.ObjectClass.ValueType:
    """A class as a number."""
    value: object_pb2.ObjectClass.ValueType = words.number(field, object_pb2.ObjectClass, object_class)
    return value


def tracked(message: object_pb2.Object) -> Object:
    """An object."""
    return Object(
        object_id=message.object_id,
        label=message.label,
        object_class=words.word(ObjectClass, object_pb2.ObjectClass, message.object_class),
        confidence=message.confidence,
        box=geometry.box(message.box),
        state=words.word(ObjectState, object_pb2.ObjectState, message.state),
        velocity_mps=geometry.vector3(message.velocity_mps),
        velocity_variance=message.velocity_variance,
        first_seen_ns=message.first_seen_ns,
        last_seen_ns=message.last_seen_ns,
        num_observations=message.num_observations,
        class_probabilities={p.label: p.probability for p in message.class_probabilities},
        annotation=ObjectAnnotation(
            label=message.annotation.label,
            is_deleted=message.annotation.is_deleted,
            part_of=message.annotation.part_of if message.annotation.HasField("part_of") else None,
            is_drawn=message.annotation.is_drawn,
        ),
        history=tuple(_past(h) for h in message.history),
    )


def _past(message: object_pb2.PastObjectState) -> PastObjectState:
    return PastObjectState(
        stamp_ns=message.stamp_ns,
        label=message.label,
        state=words.word(ObjectState, object_pb2.ObjectState, message.state),
        box=geometry.box(message.box),
    )


def object_change(message: object_pb2.ObjectChange) -> ObjectChange:
    """A change."""
    kind = words.word(ObjectChangeKind, object_pb2.ObjectChangeKind, message.kind)
    return ObjectChange(
        object_id=message.object_id,
        kind=kind,
        object=tracked(message.object) if message.HasField("object") else None,
        merged_into=message.merged_into if message.HasField("merged_into") else None,
    )


def features(message: object_pb2.ShapeFeatures) -> ShapeFeatures:
    """Shape of a set of points."""
    return ShapeFeatures(
        num_points=message.num_points,
        centroid=geometry.vector3(message.centroid),
        extent_m=geometry.vector3(message.extent_m),
        volume_m3=message.volume_m3,
        eigenvalues_m2=geometry.vector3(message.eigenvalues_m2),
        linearity=message.linearity,
        planarity=message.planarity,
        sphericity=message.sphericity,
        variance_m2=geometry.vector3(message.variance_m2),
        hull_volume_m3=message.hull_volume_m3,
        hull_area_m2=message.hull_area_m2,
        eigenvectors=np.array([[v.x, v.y, v.z] for v in message.eigenvectors]).reshape(-1, 3),
    )


def detection(message: object_pb2.Detection) -> Detection:
    """A thing found in one cloud."""
    return Detection(
        object_class=words.word(ObjectClass, object_pb2.ObjectClass, message.object_class),
        confidence=message.confidence,
        box=geometry.box(message.box),
        features=features(message.features),
    )


def room(message: scene_pb2.Room) -> Room:
    """A room."""
    return Room(
        room_id=message.room_id,
        kind=words.word(RoomKind, scene_pb2.RoomKind, message.kind),
        name=message.name,
        likely_use=message.likely_use,
        was_entered=message.was_entered,
        center=geometry.vector2(message.center),
        radius_m=message.radius_m,
        area_m2=message.area_m2,
        outline=np.array([(p.x, p.y) for p in message.outline], np.float64).reshape(-1, 2),
        object_ids=tuple(message.object_ids),
    )


def door(message: scene_pb2.Door) -> Door:
    """A door."""
    return Door(
        room_ids=(message.room_id_1, message.room_id_2),
        center=geometry.vector2(message.center),
        width_m=message.width_m,
        angle_rad=message.angle_rad,
    )


def _place(message: scene_pb2.Place) -> Place:
    return Place(
        place_id=message.place_id,
        position=geometry.vector2(message.position),
        clearance_m=message.clearance_m,
        room_id=message.room_id,
        is_in_door=message.is_in_door,
    )


def rooms(message: service.GetRoomsResponse) -> Rooms:
    """Rooms, doors, places."""
    return Rooms(
        rooms=tuple(room(r) for r in message.rooms),
        doors=tuple(door(d) for d in message.doors),
        places=tuple(_place(p) for p in message.places),
        links=tuple(
            PlaceLink(place_ids=(k.place_id_1, k.place_id_2), length_m=k.length_m) for k in message.links
        ),
        map_version=message.map_version,
    )


def _node(message: scene_pb2.SceneNode) -> SceneNode:
    return SceneNode(
        node_id=message.node_id,
        kind=words.word(SceneNodeKind, scene_pb2.SceneNodeKind, message.kind),
        label=message.label,
        t_map_node=geometry.pose(message.t_map_node),
        object=tracked(message.object) if message.HasField("object") else None,
        room=room(message.room) if message.HasField("room") else None,
    )


def _relation(message: scene_pb2.Relation) -> Relation:
    return Relation(
        subject_id=message.subject_id,
        kind=words.word(RelationKind, scene_pb2.RelationKind, message.kind),
        object_id=message.object_id,
        strength=message.strength,
        frame=words.word(RelationFrame, scene_pb2.RelationFrame, message.frame),
        distance_m=message.distance_m,
        stamp_ns=message.stamp_ns if message.HasField("stamp_ns") else None,
    )


def graph(message: scene_pb2.SceneGraph) -> SceneGraph:
    """The scene graph."""
    return SceneGraph(
        stamp_ns=message.stamp_ns,
        map_version=message.map_version,
        frame_id=message.frame_id,
        nodes=tuple(_node(n) for n in message.nodes),
        relations=tuple(_relation(r) for r in message.relations),
    )


def list_objects(
    session_id: str,
    *,
    object_class: ObjectClass | str | None,
    text: str,
    low: Sequence[float] | None,
    high: Sequence[float] | None,
    room_id: int | None,
    seen_since_ns: int | None,
    seen_until_ns: int | None,
    near: Sequence[float] | None,
    at_ns: int | None,
    include_gone: bool,
    include_set_aside: bool,
    page_size: int,
) -> PagedCall[service.ListObjectsRequest, service.ListObjectsResponse, Object]:
    request = service.ListObjectsRequest(
        session_id=session_id,
        page_size=page_size,
        label=str(object_class or ""),
        text=text,
        region=geometry.box3_to("region", low, high),
        room_id=room_id,
        seen_since_ns=seen_since_ns,
        seen_until_ns=seen_until_ns,
        near=None if near is None else geometry.vector3_to("near", near),
        at_ns=at_ns,
        include_gone=include_gone,
        include_set_aside=include_set_aside,
    )
    return PagedCall(_rpc.LIST_OBJECTS, request, lambda a: [tracked(o) for o in a.objects])


def get_object(
    session_id: str, object_id: int
) -> Call[service.GetObjectRequest, service.GetObjectResponse, Object]:
    request = service.GetObjectRequest(session_id=session_id, object_id=object_id)
    return Call(_rpc.GET_OBJECT, request, lambda a: tracked(a.object))


def correct_object(
    session_id: str,
    object_id: int,
    *,
    label: str | None = None,
    is_deleted: bool | None = None,
    part_of: int | None = None,
    pieces: service.ObjectPieces | None = None,
    learn: bool = False,
) -> Call[service.CorrectObjectRequest, service.CorrectObjectResponse, tuple[Object, ...]]:
    """One correction: label, is_deleted, part_of or pieces."""
    request = service.CorrectObjectRequest(session_id=session_id, object_id=object_id, learn=learn)
    if label is not None:
        request.label = label
    if is_deleted is not None:
        request.is_deleted = is_deleted
    if part_of is not None:
        request.part_of = part_of
    if pieces is not None:
        request.pieces.CopyFrom(pieces)
    return Call(_rpc.CORRECT_OBJECT, request, lambda a: tuple(tracked(o) for o in a.objects))


def pieces(boxes: Sequence[OrientedBox]) -> service.ObjectPieces:
    """Boxes as a message."""
    return service.ObjectPieces(boxes=[geometry.box_to(b) for b in boxes])


def list_classes(
    session_id: str,
) -> Call[service.ListObjectClassesRequest, service.ListObjectClassesResponse, tuple[ObjectClassInfo, ...]]:
    request = service.ListObjectClassesRequest(session_id=session_id)
    return Call(_rpc.LIST_OBJECT_CLASSES, request, lambda a: tuple(_class_info(c) for c in a.classes))


def _class_info(message: service.ObjectClassInfo) -> ObjectClassInfo:
    return ObjectClassInfo(
        label=message.label,
        is_built_in=message.is_built_in,
        num_examples=message.num_examples,
        num_objects=message.num_objects,
    )


def forget_class(
    session_id: str, label: str
) -> Call[service.ForgetObjectClassRequest, service.ForgetObjectClassResponse, int]:
    request = service.ForgetObjectClassRequest(session_id=session_id, label=label)
    return Call(_rpc.FORGET_OBJECT_CLASS, request, lambda a: a.num_examples)


def filter_to(asked: RelationFilter) -> scene_pb2.RelationFilter:
    """A filter as a message."""
    return scene_pb2.RelationFilter(
        kinds=[words.number("kinds", scene_pb2.RelationKind, kind) for kind in asked.kinds],
        subject_id=asked.subject_id,
        object_id=asked.object_id,
        subject_label=str(asked.subject_class or ""),
        object_label=str(asked.object_class or ""),
        room_id=asked.room_id,
        region=geometry.box3_to("region", asked.low, asked.high),
        min_strength=asked.min_strength,
    )


def get_graph(
    session_id: str,
    directions: RelationFrame | str | None,
    viewer_yaw_rad: float,
    asked: RelationFilter | None,
    at_ns: int | None,
    since_ns: int | None,
) -> Call[service.GetSceneGraphRequest, service.GetSceneGraphResponse, SceneGraph]:
    request = service.GetSceneGraphRequest(
        session_id=session_id,
        directions=words.number(
            "directions", scene_pb2.RelationFrame, directions or RelationFrame.UNSPECIFIED
        ),
        viewer_yaw_rad=viewer_yaw_rad,
        filter=None if asked is None else filter_to(asked),
        at_ns=at_ns,
        since_ns=since_ns,
    )
    return Call(_rpc.GET_SCENE_GRAPH, request, lambda a: graph(a.graph))


def get_rooms(
    session_id: str, with_places: bool
) -> Call[service.GetRoomsRequest, service.GetRoomsResponse, Rooms]:
    request = service.GetRoomsRequest(session_id=session_id, with_places=with_places)
    return Call(_rpc.GET_ROOMS, request, rooms)


def name_room(
    session_id: str, room_id: int, name: str
) -> Call[service.NameRoomRequest, service.NameRoomResponse, Room]:
    request = service.NameRoomRequest(session_id=session_id, room_id=room_id, name=name)
    return Call(_rpc.NAME_ROOM, request, lambda a: room(a.room))
