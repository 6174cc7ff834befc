"""Checks of arrays that users give; messages name the shape and type that came and that are wanted."""

from __future__ import annotations

import datetime
import math
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import InvalidArgument

Array = npt.NDArray[Any]


def checked(field: str, value: object, shape: Sequence[int | str], *dtypes: npt.DTypeLike) -> Array:
    """`value` as a C-contiguous little-endian array; letters in `shape` stand for any length.

    Nothing is cast: a depth image of the wrong type would otherwise be wrong by its scale without a word.
    """
    array = value if isinstance(value, np.ndarray) else None
    fits = (
        array is not None
        and array.ndim == len(shape)
        and all(isinstance(want, str) or have == want for have, want in zip(array.shape, shape, strict=True))
        and any(array.dtype.newbyteorder("=") == np.dtype(dtype) for dtype in dtypes)
    )
    if array is None or not fits:
        wanted = f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
        types = " or ".join(np.dtype(dtype).name for dtype in dtypes)
        came = f"{array.shape} {array.dtype.name}" if array is not None else type(value).__name__
        message = (
            f"{field} must be an array of shape {wanted} and type {types}, not {came}; reshape or cast it"
        )
        raise InvalidArgument(message, reason="ARRAY_INVALID", field=field)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def vector(field: str, value: object, length: int) -> npt.NDArray[np.float64]:
    """`length` numbers as float64; sequences are welcome."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (length,):
        message = f"{field} must be {length} numbers, not {value!r}"
        raise InvalidArgument(message, reason="ARRAY_INVALID", field=field)
    return array


def number(field: str, value: object, *, low: float = -math.inf, high: float = math.inf, must: str) -> float:
    """A number above `low` and at most `high`, neither infinite nor NaN; `must` says so in words."""
    try:
        read = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        read = math.nan
    if math.isfinite(read) and low < read <= high:
        return read
    raise InvalidArgument(f"{field} is {value!r}; it must be {must}", reason="OUT_OF_RANGE", field=field)


def stamp(value: object) -> int:
    """Nanoseconds of a stamp: a whole number, of Python's or of NumPy's."""
    try:
        # True is an int to Python, and a mistake here.
        stamp_ns = None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        stamp_ns = None
    if stamp_ns is None or not -(2**63) <= stamp_ns < 2**63:
        message = (
            f"stamp_ns must be a whole number of nanoseconds of 64 bits, not {value!r}; {_stamp_of(value)}"
        )
        raise InvalidArgument(message, reason="STAMP_INVALID", field="stamp_ns")
    return stamp_ns


def _stamp_of(value: object) -> str:
    """What to send instead."""
    if isinstance(value, np.datetime64):
        return 'send int(when.astype("datetime64[ns]").astype("int64"))'
    if not isinstance(value, datetime.datetime):
        return "send e.g. time.time_ns(), or round(seconds * 1e9)"
    # Also pandas' Timestamp, which is one and keeps nanoseconds.
    send = "when.value" if hasattr(value, "value") else "round(when.timestamp() * 1e9)"
    if value.tzinfo is None:
        return f"it has no time zone: name it first (when.replace(tzinfo=...)), then send {send}"
    return f"send {send}"


def same_length(field: str, array: Array | None, length: int) -> None:
    """Refuses a channel that has not one entry a point."""
    if array is not None and len(array) != length:
        message = f"{field} has {len(array)} entries for {length} points; send one a point"
        raise InvalidArgument(message, reason="SIZE_MISMATCH", field=field)
