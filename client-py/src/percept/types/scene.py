"""Scene: objects and how they relate."""

from __future__ import annotations

from dataclasses import dataclass

from ._value import Name, Value
from .geometry import Floats, OrientedBox, Pose


class ObjectClass(Name):
    """Classes of the built-in classifier."""

    UNSPECIFIED = "unspecified"
    UNKNOWN = "unknown"
    TABLE = "table"
    CHAIR = "chair"
    SHELF = "shelf"
    BOX = "box"
    CYLINDER = "cylinder"
    PERSON = "person"


class ObjectState(Name):
    """What an object does."""

    UNSPECIFIED = "unspecified"
    STATIC = "static"
    MOVING = "moving"
    GONE = "gone"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Object(Value):
    """A tracked thing."""

    #: Stable through the session.
    object_id: int
    object_class: ObjectClass
    #: Probability of the class.
    confidence: float
    #: Upright, map frame.
    box: OrientedBox
    state: ObjectState
    first_seen_ns: int
    last_seen_ns: int
    num_observations: int


class ObjectChangeKind(Name):
    """What happened to an object."""

    UNSPECIFIED = "unspecified"
    APPEARED = "appeared"
    UPDATED = "updated"
    GONE = "gone"
    REMOVED = "removed"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ObjectChange(Value):
    """A change of one object."""

    kind: ObjectChangeKind
    #: After the change.
    object: Object


class SceneNodeKind(Name):
    """What a node of the scene graph stands for."""

    UNSPECIFIED = "unspecified"
    ROBOT = "robot"
    OBJECT = "object"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SceneNode(Value):
    """A node of the scene graph."""

    #: Unique in the graph: "robot", "object/7".
    node_id: str
    kind: SceneNodeKind
    label: str
    t_map_node: Pose
    object: Object | None


class RelationKind(Name):
    """How one thing stands to another."""

    UNSPECIFIED = "unspecified"
    ON = "on"
    INSIDE = "inside"
    NEAR = "near"
    ABOVE = "above"
    BELOW = "below"
    LEFT_OF = "left_of"
    RIGHT_OF = "right_of"
    IN_FRONT_OF = "in_front_of"
    BEHIND = "behind"


class RelationFrame(Name):
    """The frame in which a relation holds."""

    UNSPECIFIED = "unspecified"
    GRAVITY = "gravity"
    VIEWER = "viewer"
    ANY = "any"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Relation(Value):
    """subject kind object, as in 'object/3 on object/1'."""

    subject_id: str
    kind: RelationKind
    object_id: str
    #: 0 to 1.
    strength: float
    frame: RelationFrame

    def __str__(self) -> str:
        return f"{self.subject_id} {self.kind} {self.object_id}"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SceneGraph(Value):
    """Who is where, and how things relate."""

    stamp_ns: int
    map_version: int
    frame_id: str
    nodes: tuple[SceneNode, ...]
    relations: tuple[Relation, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ShapeFeatures(Value):
    """Shape of a set of points; eigenvalues l1 >= l2 >= l3 of the covariance of the positions."""

    num_points: int
    #: Metres, (3,).
    centroid: Floats
    #: Axis-aligned, metres, (3,).
    extent_m: Floats
    #: Of the smallest box upright along z, cubic metres.
    volume_m3: float
    #: Square metres, (3,).
    eigenvalues_m2: Floats
    #: (l1 - l2) / l1.
    linearity: float
    #: (l2 - l3) / l1.
    planarity: float
    #: l3 / l1.
    sphericity: float
    #: Along x, y, z, square metres, (3,).
    variance_m2: Floats
    #: Of the convex hull, cubic metres; 0 if flat.
    hull_volume_m3: float
    #: Of the convex hull's surface, square metres; both sides if flat.
    hull_area_m2: float
    #: (3, 3): unit vectors, one a row, in the order of the eigenvalues.
    eigenvectors: Floats


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Detection(Value):
    """A thing found in one cloud."""

    object_class: ObjectClass
    confidence: float
    #: Upright, frame of the input.
    box: OrientedBox
    features: ShapeFeatures
