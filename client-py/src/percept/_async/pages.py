"""Results that come page by page."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Generic, TypeVar

from ..types.listing import Listing

T = TypeVar("T")


class AsyncPages(AsyncIterator[T], Generic[T]):
    """Elements of a list that the server gives page by page: asked for as they are used, or all at once."""

    def __init__(self, elements: AsyncIterator[T]) -> None:
        self._elements = elements

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: asked for as they are used in a loop; .all() gives a list>"

    def __aiter__(self) -> AsyncPages[T]:
        return self

    async def __anext__(self) -> T:
        return await self._elements.__anext__()

    async def all(self) -> Listing[T]:
        """All that are left, as a list that a notebook shows as a table, and that to_pandas() takes."""
        return Listing([element async for element in self])
