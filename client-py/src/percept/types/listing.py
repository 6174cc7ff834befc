"""Lists of results, as a notebook shows them and pandas takes them."""

from __future__ import annotations

from typing import Any, TypeVar

from .._optional import needed
from ._show import flat, table

T = TypeVar("T")


class Listing(list[T]):
    """A list of objects, sessions, sensors ...; a table in a notebook."""

    def _repr_html_(self) -> str:
        if not self:
            return "<p>none</p>"
        return table((flat(item) for item in self), getattr(self[0], "_columns", ()), caption=f"{len(self)}")

    def to_pandas(self) -> Any:  # noqa: ANN401
        """A pandas.DataFrame with a row for each: numbers and words in columns, those of parts named after
        the part (box_x_m), units in the names. Longer arrays are left out. ImportError without pandas."""
        pandas = needed("pandas", "to_pandas()", "pandas")
        return pandas.DataFrame([flat(item) for item in self])
