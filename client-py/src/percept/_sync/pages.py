# Written by client-py/generate from _async/pages.py; change that.
"""Results that come page by page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

from ..types.listing import Listing

T = TypeVar("T")


class Pages(Iterator[T], Generic[T]):
    """Elements of a list that the server gives page by page: asked for as they are used, or all at once."""

    def __init__(self, elements: Iterator[T]) -> None:
        self._elements = elements

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: asked for as they are used in a loop; .all() gives a list>"

    def __iter__(self) -> Pages[T]:
        return self

    def __next__(self) -> T:
        return self._elements.__next__()

    def all(self) -> Listing[T]:
        """All that are left, as a list that a notebook shows as a table, and that to_pandas() takes."""
        return Listing([element for element in self])
