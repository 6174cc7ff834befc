"""Scene: objects and how they relate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ._show import image, png, table
from ._value import Name, Value
from .geometry import Floats, OrientedBox, Pose


class ObjectClass(Name):
    """Classes of the built-in classifiers."""

    UNSPECIFIED = "unspecified"
    UNKNOWN = "unknown"
    TABLE = "table"
    CHAIR = "chair"
    SHELF = "shelf"
    BOX = "box"
    CYLINDER = "cylinder"
    PERSON = "person"
    CAR = "car"
    VAN = "van"
    TRUCK = "truck"
    BUS = "bus"
    CYCLIST = "cyclist"
    MOTORCYCLE = "motorcycle"


class ObjectState(Name):
    """What an object does."""

    UNSPECIFIED = "unspecified"
    STATIC = "static"
    MOVING = "moving"
    GONE = "gone"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ObjectAnnotation(Value):
    """What people said of an object."""

    #: What it is; empty if nobody said.
    label: str
    #: It is no thing.
    is_deleted: bool
    #: It is a part of that object, whose box holds it.
    part_of: int | None
    #: Its box was drawn by a person.
    is_drawn: bool


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PastObjectState(Value):
    """What an object was from a stamp on."""

    #: From when on.
    stamp_ns: int
    label: str
    state: ObjectState
    #: Upright, in the map frame as it is now.
    box: OrientedBox


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Object(Value):
    """A tracked thing."""

    _columns = (
        "object_id",
        "label",
        "confidence",
        "state",
        *(f"box_{name}" for name in ("x_m", "y_m", "z_m", "yaw_rad", "size_x_m", "size_y_m", "size_z_m")),
        "num_observations",
    )

    #: Stable through the session.
    object_id: int
    #: Name of its class, lower case: "table", or one that people or models named.
    label: str
    #: "unknown" if its class is none of the built-in ones.
    object_class: ObjectClass
    #: Probability of the class; 1 if a person said what it is.
    confidence: float
    #: Upright, map frame.
    box: OrientedBox
    state: ObjectState
    #: Of its centre, map frame, metres a second, (3,); zero unless moving.
    velocity_mps: Floats
    #: Of the velocity along x, and along y, (m/s)^2; zero unless moving.
    velocity_variance: float
    #: Stamps of the first and the newest frame that saw it.
    first_seen_ns: int
    last_seen_ns: int
    num_observations: int
    #: Classes that it was taken for, likeliest first. What they lack to 1 is shared by all others.
    class_probabilities: dict[str, float]
    annotation: ObjectAnnotation
    #: What it was before, oldest first. Only of an object that was asked for by its number.
    history: tuple[PastObjectState, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ObjectClassInfo(Value):
    """A class of objects in a session."""

    label: str
    #: Known without examples.
    is_built_in: bool
    #: Examples that people gave.
    num_examples: int
    #: Objects of it that are told and not gone.
    num_objects: int


class ObjectChangeKind(Name):
    """What happened to an object."""

    UNSPECIFIED = "unspecified"
    APPEARED = "appeared"
    UPDATED = "updated"
    GONE = "gone"
    #: It turned out to be a part of another.
    MERGED = "merged"
    RECLASSIFIED = "reclassified"
    STARTED_MOVING = "started_moving"
    STOPPED = "stopped"
    #: It was gone and is seen again.
    REAPPEARED = "reappeared"
    #: It turned out to be no thing of its own, or it was gone and made room for others.
    FORGOTTEN = "forgotten"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ObjectChange(Value):
    """A change of one object."""

    object_id: int
    kind: ObjectChangeKind
    #: After the change; none if it is no more (merged, forgotten).
    object: Object | None
    #: The object that it is a part of, if it was merged.
    merged_into: int | None


class RoomKind(Name):
    """Rooms by their shape."""

    UNSPECIFIED = "unspecified"
    ROOM = "room"
    #: Long and narrow: it leads from room to room.
    CORRIDOR = "corridor"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Room(Value):
    """A part of the floor between walls and doors."""

    #: Stays while the map grows and is corrected, of a room that the robot was in.
    room_id: int
    kind: RoomKind
    #: What people call it; empty if they do not.
    name: str
    #: What it is likely used for, by what stands in it; empty if that does not tell.
    likely_use: str
    #: False: it was only looked into.
    was_entered: bool
    #: Where it is widest, map frame, metres, (2,).
    center: Floats
    #: Of the largest circle that fits, metres.
    radius_m: float
    #: Of its floor, what stands there included, square metres.
    area_m2: float
    #: Its outer border, counter-clockwise, map frame, metres, (N, 2).
    outline: Floats
    #: Objects in it that are not gone.
    object_ids: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Door(Value):
    """A doorway between two rooms."""

    #: The smaller number first.
    room_ids: tuple[int, int]
    #: In its middle, map frame, metres, (2,).
    center: Floats
    #: Between its jambs, metres.
    width_m: float
    #: From jamb to jamb, radians from the map's x axis, -pi/2 to pi/2.
    angle_rad: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Place(Value):
    """A place to be. Numbers are new with each version of the map."""

    place_id: int
    #: Map frame, metres, (2,).
    position: Floats
    #: From the nearest obstacle, metres.
    clearance_m: float
    room_id: int
    #: It lies in a doorway.
    is_in_door: bool


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PlaceLink(Value):
    """A way over free floor between neighbouring places."""

    #: The smaller number first.
    place_ids: tuple[int, int]
    length_m: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rooms(Value):
    """A level divided into rooms."""

    #: By number.
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    #: Empty unless asked for.
    places: tuple[Place, ...]
    links: tuple[PlaceLink, ...]
    #: Of the map that was divided.
    map_version: int


class SceneNodeKind(Name):
    """What a node of the scene graph stands for."""

    UNSPECIFIED = "unspecified"
    ROBOT = "robot"
    OBJECT = "object"
    ROOM = "room"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SceneNode(Value):
    """A node of the scene graph."""

    #: Unique in the graph: "robot", "object/7", "room/3072".
    node_id: str
    kind: SceneNodeKind
    label: str
    #: Its middle, and which way it lies, in map.
    t_map_node: Pose
    #: Of an object.
    object: Object | None
    #: Of a room.
    room: Room | None


class RelationKind(Name):
    """How one thing stands to another."""

    UNSPECIFIED = "unspecified"
    #: It rests on top.
    ON = "on"
    #: The other way round of ON.
    SUPPORTS = "supports"
    #: Most of it lies within what can hold things.
    INSIDE = "inside"
    #: It stands under its top, between its legs.
    UNDER = "under"
    #: Over it, or beneath it, apart from it.
    ABOVE = "above"
    BELOW = "below"
    #: Nobody passes between them; in one room and in sight. Listed once.
    NEXT_TO = "next_to"
    #: The nearest to each other, in one room and in sight; or the robot's. Listed once.
    NEAR = "near"
    #: Robot or object in a room.
    IN_ROOM = "in_room"
    #: A door leads from one room to the other. Listed once.
    CONNECTED_TO = "connected_to"
    #: Only if RelationFilter.kinds names it: the robot, the object, can drive from where it is over free
    #: floor into the room, or up to the thing: to a place in its room within 1.5 m of its footprint, no
    #: wall between. Strength 1; distance_m is the way there.
    REACHABLE_FROM = "reachable_from"
    #: These only with directions.
    LEFT_OF = "left_of"
    RIGHT_OF = "right_of"
    IN_FRONT_OF = "in_front_of"
    BEHIND = "behind"
    #: These only with since_ns: what happened to a thing in a room, or in none that is known.
    APPEARED_IN = "appeared_in"
    DISAPPEARED_FROM = "disappeared_from"
    MOVED_FROM = "moved_from"
    MOVED_TO = "moved_to"
    #: What happened to it came before what happened to the other, which came next; or within two seconds.
    BEFORE = "before"
    TOGETHER = "together"


class RelationFrame(Name):
    """The frame in which a relation holds."""

    UNSPECIFIED = "unspecified"
    #: On, under, above, below.
    GRAVITY = "gravity"
    #: The same in every frame.
    ANY = "any"
    #: As the robot sees it at the graph's stamp.
    ROBOT = "robot"
    #: Of somebody who looks along the map's x axis.
    MAP = "map"
    #: Of somebody who looks along viewer_yaw.
    VIEWER = "viewer"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Relation(Value):
    """subject kind object, as in 'object/3 on object/1'."""

    subject_id: str
    kind: RelationKind
    object_id: str
    #: 0 to 1.
    strength: float
    frame: RelationFrame
    #: Gap between the two, metres; of what moved, how far.
    distance_m: float
    #: When it happened; None of what holds at the graph's stamp.
    stamp_ns: int | None

    def __str__(self) -> str:
        return f"{self.subject_id} {self.kind} {self.object_id}"


@dataclass(frozen=True, kw_only=True)
class RelationFilter:
    """Which relations are asked for: all that is set has to hold."""

    #: One of these; empty: any but "reachable_from", which has to be named.
    kinds: Sequence[RelationKind | str] = ()
    #: "robot", "object/7", "room/3072".
    subject_id: str = ""
    object_id: str = ""
    #: Of the subject: any label.
    subject_class: ObjectClass | str | None = None
    #: Of the object: any label.
    object_class: ObjectClass | str | None = None
    #: Subject or object is in this room, or is it.
    room_id: int | None = None
    #: The middle of the subject lies between these corners, map frame, metres, (3,).
    low: Sequence[float] | None = None
    #: The other corner.
    high: Sequence[float] | None = None
    #: At least; 0 to 1.
    min_strength: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SceneGraph(Value):
    """Who is where, and how things relate."""

    #: Time that it holds at.
    stamp_ns: int
    map_version: int
    #: Of all coordinates in it.
    frame_id: str
    nodes: tuple[SceneNode, ...]
    relations: tuple[Relation, ...]

    def _repr_html_(self) -> str:
        labels = {node.node_id: f"{node.label} ({node.node_id})" for node in self.nodes}
        rows = [
            {
                "subject": labels.get(r.subject_id, r.subject_id),
                "relation": r.kind,
                "object": labels.get(r.object_id, r.object_id),
                "strength": r.strength,
                "distance_m": r.distance_m,
                "frame": r.frame,
            }
            for r in self.relations
        ]
        picture = image(png(lambda plot: plot.scene(self)))
        return picture + table(rows, caption=f"{len(self.nodes)} nodes, {len(rows)} relations")


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
