# Written by client-py/generate from _async/scene.py; change that.
"""Scene: the things in the map, and how they relate."""

from __future__ import annotations

from collections.abc import Iterator

from .._convert import scene as convert
from ..types.scene import Object, ObjectClass, SceneGraph
from .bound import SessionBound


class Scene(SessionBound):
    """Objects and relations of a session."""

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

    def graph(self) -> SceneGraph:
        """Robot, objects and their relations."""
        return self._transport.call(convert.get_graph(self.session_id))
