"""Scene: the things in the map, and how they relate."""

from __future__ import annotations

from collections.abc import AsyncIterator

from .._convert import scene as convert
from ..types.scene import Object, ObjectClass, SceneGraph
from .bound import AsyncSessionBound


class AsyncScene(AsyncSessionBound):
    """Objects and relations of a session."""

    def objects(
        self,
        *,
        object_class: ObjectClass | str | None = None,
        include_gone: bool = False,
        page_size: int = 0,
    ) -> AsyncIterator[Object]:
        """Objects by id; pages are asked for as they are used."""
        call = convert.list_objects(self.session_id, object_class, include_gone, page_size)
        return self._transport.pages(call)

    async def object(self, object_id: int) -> Object:
        """One object."""
        return await self._transport.call(convert.get_object(self.session_id, object_id))

    async def graph(self) -> SceneGraph:
        """Robot, objects and their relations."""
        return await self._transport.call(convert.get_graph(self.session_id))
