"""Objects and the scene graph."""

from __future__ import annotations

import numpy as np

from .. import _rpc
from .._call import Call, PagedCall
from ..types.scene import (
    Detection,
    Object,
    ObjectChange,
    ObjectChangeKind,
    ObjectClass,
    ObjectState,
    Relation,
    RelationFrame,
    RelationKind,
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
        object_class=words.word(ObjectClass, object_pb2.ObjectClass, message.object_class),
        confidence=message.confidence,
        box=geometry.box(message.box),
        state=words.word(ObjectState, object_pb2.ObjectState, message.state),
        first_seen_ns=message.first_seen_ns,
        last_seen_ns=message.last_seen_ns,
        num_observations=message.num_observations,
    )


def object_change(message: object_pb2.ObjectChange) -> ObjectChange:
    """A change."""
    kind = words.word(ObjectChangeKind, object_pb2.ObjectChangeKind, message.kind)
    return ObjectChange(kind=kind, object=tracked(message.object))


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


def _node(message: scene_pb2.SceneNode) -> SceneNode:
    return SceneNode(
        node_id=message.node_id,
        kind=words.word(SceneNodeKind, scene_pb2.SceneNodeKind, message.kind),
        label=message.label,
        t_map_node=geometry.pose(message.t_map_node),
        object=tracked(message.object) if message.HasField("object") else None,
    )


def _relation(message: scene_pb2.Relation) -> Relation:
    return Relation(
        subject_id=message.subject_id,
        kind=words.word(RelationKind, scene_pb2.RelationKind, message.kind),
        object_id=message.object_id,
        strength=message.strength,
        frame=words.word(RelationFrame, scene_pb2.RelationFrame, message.frame),
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
    session_id: str, object_class: ObjectClass | str | None, include_gone: bool, page_size: int
) -> PagedCall[service.ListObjectsRequest, service.ListObjectsResponse, Object]:
    request = service.ListObjectsRequest(
        session_id=session_id,
        page_size=page_size,
        object_class=class_to("object_class", object_class or ObjectClass.UNSPECIFIED),
        include_gone=include_gone,
    )
    return PagedCall(_rpc.LIST_OBJECTS, request, lambda a: [tracked(o) for o in a.objects])


def get_object(
    session_id: str, object_id: int
) -> Call[service.GetObjectRequest, service.GetObjectResponse, Object]:
    request = service.GetObjectRequest(session_id=session_id, object_id=object_id)
    return Call(_rpc.GET_OBJECT, request, lambda a: tracked(a.object))


def get_graph(
    session_id: str,
) -> Call[service.GetSceneGraphRequest, service.GetSceneGraphResponse, SceneGraph]:
    request = service.GetSceneGraphRequest(session_id=session_id)
    return Call(_rpc.GET_SCENE_GRAPH, request, lambda a: graph(a.graph))
