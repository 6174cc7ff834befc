# Written by client-py/generate from _async/scene.py; change that.
"""Scene: the things in the map, and how they relate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .._convert import navigation
from .._convert import scene as convert
from ..types.navigation import RoomRoute
from ..types.scene import Object, ObjectClass, RelationFilter, RelationFrame, Room, Rooms, SceneGraph
from .bound import SessionBound


class Scene(SessionBound):
    """Objects, rooms and relations of a session."""

    def objects(
        self,
        *,
        object_class: ObjectClass | str | None = None,
        include_gone: bool = False,
        page_size: int = 0,
    ) -> Iterator[Object]:
        """Objects by id; pages are asked for as they are used."""
        call = convert.list_objects(self.session_id, object_class, include_gone, page_size)
        return self._transport.pages(call)

    def object(self, object_id: int) -> Object:
        """One object."""
        return self._transport.call(convert.get_object(self.session_id, object_id))

    def graph(
        self,
        *,
        directions: RelationFrame | str | None = None,
        viewer_yaw_rad: float = 0.0,
        relations: RelationFilter | None = None,
    ) -> SceneGraph:
        """Robot, objects, rooms and their relations.

        Left and right, front and behind are only listed with directions: for "robot", "map" (who looks along
        its x axis), or "viewer" (who looks along viewer_yaw_rad, from the map's x axis). With relations the
        graph has those that pass the filter, and the nodes that they join.
        """
        call = convert.get_graph(self.session_id, directions, viewer_yaw_rad, relations)
        return self._transport.call(call)

    def rooms(self, *, with_places: bool = False) -> Rooms:
        """Rooms and the doors between them; with places to be, and the ways between those."""
        return self._transport.call(convert.get_rooms(self.session_id, with_places))

    def name_room(self, room_id: int, name: str) -> Room:
        """Calls a room by a name, which stays with it while the map grows; an empty one takes it away."""
        return self._transport.call(convert.name_room(self.session_id, room_id, name))

    def route_to_room(self, room: int | str, *, start: Sequence[float] | None = None) -> RoomRoute:
        """The way to a room, by number or name: from door to door, and the path along the ground.

        start is x, y, map frame, metres; without one the way begins where the robot is.
        """
        return self._transport.call(navigation.route_to_room(self.session_id, room, start))
