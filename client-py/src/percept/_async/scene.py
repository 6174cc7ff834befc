"""Scene: the things in the map, and how they relate."""

from __future__ import annotations

from collections.abc import Sequence

from .._convert import navigation
from .._convert import scene as convert
from ..types.geometry import FloorPoint, OrientedBox
from ..types.navigation import RoomRoute
from ..types.scene import (
    Object,
    ObjectClass,
    ObjectClassInfo,
    RelationFilter,
    RelationFrame,
    Room,
    Rooms,
    SceneGraph,
)
from .bound import AsyncSessionBound
from .pages import AsyncPages


class AsyncScene(AsyncSessionBound):
    """Objects, rooms and relations of a session."""

    def objects(
        self,
        *,
        object_class: ObjectClass | str | None = None,
        text: str = "",
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        room_id: int | None = None,
        seen_since_ns: int | None = None,
        seen_until_ns: int | None = None,
        near: Sequence[float] | None = None,
        at_ns: int | None = None,
        include_gone: bool = False,
        include_set_aside: bool = False,
        page_size: int = 0,
    ) -> AsyncPages[Object]:
        """Objects by id; pages are asked for as they are used, `.all()` gives a list of all.

        object_class is any label, text a part of one. Those whose middle lies between low and high (3,), map
        frame, metres; those in a room; those seen in a time. With near (3,) the nearest come first, page_size
        of them (100 if it is 0). at_ns asks for them as they were then, include_set_aside also for those that
        people deleted or made parts of others.
        """
        call = convert.list_objects(
            self.session_id,
            object_class=object_class,
            text=text,
            low=low,
            high=high,
            room_id=room_id,
            seen_since_ns=seen_since_ns,
            seen_until_ns=seen_until_ns,
            near=near,
            at_ns=at_ns,
            include_gone=include_gone,
            include_set_aside=include_set_aside,
            page_size=page_size,
        )
        return self._transport.pages(call)

    async def object(self, object_id: int) -> Object:
        """One object, and what it was before."""
        return await self._transport.call(convert.get_object(self.session_id, object_id))

    async def label(self, object_id: int, label: str, *, learn: bool = False) -> Object:
        """Says what an object is, whatever is detected from now on; an empty label takes that back.

        learn: things that look more like it than like any other class are taken for that class, too, from the
        next search on. Beside a class of percept's own that looks the same, that one is named as a rule.
        """
        call = convert.correct_object(self.session_id, object_id, label=label, learn=learn)
        return (await self._transport.call(call))[0]

    async def delete_object(self, object_id: int) -> Object:
        """It is no thing: it is not told any more while something stands there."""
        return (
            await self._transport.call(convert.correct_object(self.session_id, object_id, is_deleted=True))
        )[0]

    async def restore_object(self, object_id: int) -> Object:
        """It is a thing of its own after all: it was deleted, split (its pieces go), or made a part."""
        return (
            await self._transport.call(convert.correct_object(self.session_id, object_id, is_deleted=False))
        )[0]

    async def merge_objects(self, object_id: int, into: int) -> tuple[Object, ...]:
        """It is a part of another, whose box then holds both; the two."""
        return await self._transport.call(convert.correct_object(self.session_id, object_id, part_of=into))

    async def split_object(self, object_id: int, boxes: Sequence[OrientedBox]) -> tuple[Object, ...]:
        """It is several things, of its class, in upright boxes, map frame; itself, deleted, and they."""
        call = convert.correct_object(self.session_id, object_id, pieces=convert.pieces(boxes))
        return await self._transport.call(call)

    async def object_classes(self) -> tuple[ObjectClassInfo, ...]:
        """Classes that objects may have, or have: built-in ones first, then by name."""
        return await self._transport.call(convert.list_classes(self.session_id))

    async def forget_class(self, label: str) -> int:
        """Forgets what was learned of a class; how many examples there were. Labels stay."""
        return await self._transport.call(convert.forget_class(self.session_id, label))

    async def graph(
        self,
        *,
        directions: RelationFrame | str | None = None,
        viewer_yaw_rad: float = 0.0,
        relations: RelationFilter | None = None,
        at_ns: int | None = None,
        since_ns: int | None = None,
    ) -> SceneGraph:
        """Robot, objects, rooms and their relations.

        Left and right, front and behind are only listed with directions: for "robot", "map" (who looks along
        its x axis), or "viewer" (who looks along viewer_yaw_rad, from the map's x axis). With relations the
        graph has those that pass the filter, and the nodes that they join. At a time it is the scene as it
        was then, in the rooms as they are now. With since_ns it tells what happened since then, too: what
        appeared, disappeared or moved, in which room, when, and in which order.
        """
        call = convert.get_graph(self.session_id, directions, viewer_yaw_rad, relations, at_ns, since_ns)
        return await self._transport.call(call)

    async def rooms(self, *, with_places: bool = False) -> Rooms:
        """Rooms and the doors between them; with places to be, and the ways between those."""
        return await self._transport.call(convert.get_rooms(self.session_id, with_places))

    async def name_room(self, room_id: int, name: str) -> Room:
        """Calls a room by a name, which stays with it while the map grows; an empty one takes it away."""
        return await self._transport.call(convert.name_room(self.session_id, room_id, name))

    async def route_to_room(self, room: int | str, *, start: FloorPoint | None = None) -> RoomRoute:
        """The way to a room, by number or name: from door to door, and the path along the ground.

        start is x, y, map frame, metres; without one the way begins where the robot is.
        """
        return await self._transport.call(navigation.route_to_room(self.session_id, room, start))
