"""Clouds and meshes as Draco packs them, read by DracoPy if it is installed."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import InvalidArgument

# Kinds of attributes, as Draco numbers them.
POSITION, NORMAL, COLOUR, GENERIC = 0, 1, 2, 4


def needed(max_error_m: float | None) -> float | None:
    """The bound, if what it asks for can be read here."""
    if max_error_m is not None:
        _reader()
    return max_error_m


def _reader() -> ModuleType:
    try:
        return importlib.import_module("DracoPy")
    except ImportError:
        message = "a packed answer is read by DracoPy: pip install 'percept[draco]', or leave max_error_m out"
        raise InvalidArgument(message, reason="MODULE_MISSING", field="max_error_m") from None


class Unpacked:
    """What is in a Draco file; of an empty one, nothing."""

    def __init__(self, data: bytes) -> None:
        read = _reader().decode(data) if data else None
        self._attributes = {} if read is None else {a["attribute_type"]: a["data"] for a in read.attributes}
        faces = getattr(read, "faces", None)
        self.triangles = np.zeros((0, 3), np.uint32) if faces is None else np.asarray(faces, np.uint32)

    def rows(self, kind: int, dtype: npt.DTypeLike, width: int = 3) -> npt.NDArray[Any] | None:
        """(N, width) of one kind; None if it is not there."""
        values = self._attributes.get(kind)
        return None if values is None else np.ascontiguousarray(values, dtype).reshape(-1, width)
