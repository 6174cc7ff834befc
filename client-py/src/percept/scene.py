"""Scene: the things in the map, and how they relate."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator

from ._aio_transport import AsyncTransport
from ._convert import scene as convert
from ._transport import Transport
from .types.scene import Object, ObjectClass, SceneGraph


class Scene:
    """Objects and relations of a session."""

    def __init__(self, transport: Transport, session_id: str) -> None:
        self._transport = transport
        self._session_id = session_id

    def objects(
        self,
        *,
        object_class: ObjectClass | str | None = None,
        include_gone: bool = False,
        page_size: int = 0,
    ) -> Iterator[Object]:
        """Objects by id; pages are asked for as they are used."""
        call = convert.list_objects(self._session_id, object_class, include_gone, page_size)
        return self._transport.pages(call)

    def object(self, object_id: int) -> Object:
        """One object."""
        return self._transport.call(convert.get_object(self._session_id, object_id))

    def graph(self) -> SceneGraph:
        """Robot, objects and their relations."""
        return self._transport.call(convert.get_graph(self._session_id))


class AsyncScene:
    """Objects and relations of a session."""

    def __init__(self, transport: AsyncTransport, session_id: str) -> None:
        self._transport = transport
        self._session_id = session_id

    def objects(
        self,
        *,
        object_class: ObjectClass | str | None = None,
        include_gone: bool = False,
        page_size: int = 0,
    ) -> AsyncIterator[Object]:
        """Objects by id; pages are asked for as they are used."""
        call = convert.list_objects(self._session_id, object_class, include_gone, page_size)
        return self._transport.pages(call)

    async def object(self, object_id: int) -> Object:
        """One object."""
        return await self._transport.call(convert.get_object(self._session_id, object_id))

    async def graph(self) -> SceneGraph:
        """Robot, objects and their relations."""
        return await self._transport.call(convert.get_graph(self._session_id))
