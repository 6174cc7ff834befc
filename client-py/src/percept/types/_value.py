"""What all results share: they print well and compare by content, arrays included."""

from __future__ import annotations

import dataclasses
from enum import Enum
from typing import Any, TypeVar

import numpy as np

from ..errors import InvalidArgument

V = TypeVar("V")


def told(kind: type[V], /, **fields: object) -> V:
    """A value as a server tells it, unchecked: a newer one may know more words, and allow more."""
    out = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(out, name, value)
    return out


class Name(str, Enum):
    """A word of the contract; equal to its lower-case string."""

    def __str__(self) -> str:
        return str(self.value)

    def __repr__(self) -> str:
        return repr(self.value)


def one_of(field: str, word: object, names: type[Name], *, or_unspecified: bool = False) -> None:
    """Refuses what is none of the words."""
    known = [str(name) for name in names if name != "unspecified"]
    if str(word).lower() not in [*known, *(["unspecified"] if or_unspecified else [])]:
        message = f"{field} is {str(word)!r}; choose one of {', '.join(known)}"
        raise InvalidArgument(message, reason="ENUM_UNKNOWN", field=field)


class Value:
    """Base of the frozen dataclasses."""

    def __repr__(self) -> str:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        parts = (f"{f.name}={_shown(getattr(self, f.name))}" for f in fields if f.repr)
        return f"{type(self).__name__}({', '.join(parts)})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        names = (f.name for f in dataclasses.fields(self))  # type: ignore[arg-type]
        return all(_same(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]


def _shown(value: Any) -> str:  # noqa: ANN401
    if isinstance(value, np.ndarray):
        if value.ndim == 1 and value.size <= 7:
            return str([float(f"{v:.4g}") if value.dtype.kind == "f" else v for v in value.tolist()])
        return f"<{' x '.join(map(str, value.shape))} {value.dtype.name}>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (tuple, list)) and len(value) > 6:
        return f"<{len(value)} x {type(value[0]).__name__}>"
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>"
    return repr(value)


def _same(a: Any, b: Any) -> bool:  # noqa: ANN401
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=getattr(a, "dtype", np.dtype(int)).kind == "f")
    return bool(a == b)
