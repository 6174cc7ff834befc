"""How results show themselves in a notebook: tables, and pictures where matplotlib is installed."""

from __future__ import annotations

import base64
import dataclasses
import html
import io
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from .._optional import needed
from ._value import Value


def flat(value: object, prefix: str = "") -> dict[str, object]:
    """The numbers and words of a value by name, those of its parts with the part's name before: `box_x_m`.
    Arrays of two or three numbers are spread, longer ones and lists left out."""
    # Their own names differ from those of their fields: a pose has no field x_m.
    if hasattr(value, "_flat"):
        return {f"{prefix}{name}": part for name, part in value._flat().items()}
    out: dict[str, object] = {}
    for field in dataclasses.fields(value):  # type: ignore[arg-type]
        part = getattr(value, field.name)
        name = f"{prefix}{field.name}"
        if isinstance(part, Value):
            out |= flat(part, f"{name}_")
        elif isinstance(part, np.ndarray):
            if part.ndim == 1 and len(part) in (2, 3):
                out |= {f"{name}_{axis}": number for axis, number in zip("xyz", part.tolist(), strict=False)}
        elif part is None or isinstance(part, (str, int, float)):
            # A word as plain text: pandas shows it so.
            out[name] = str(part) if isinstance(part, str) else part
    return out


def table(rows: Iterable[Mapping[str, object]], columns: Iterable[str] = (), *, caption: str = "") -> str:
    """HTML of rows; the columns that are named, or all."""
    rows = list(rows)
    names = list(columns) or list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "".join("<tr>" + "".join(f"<td>{_cell(row.get(n))}</td>" for n in names) + "</tr>" for row in rows)
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else html.escape(str(value))


def png(draw: Callable[[Any], Any]) -> bytes | None:
    """What a function draws with percept.plot; None where matplotlib is missing: it then shows as text."""
    try:
        from .. import plot

        picture: bytes = draw(plot).figure._repr_png_()
    except ImportError:
        return None
    return picture


def image(data: bytes | None) -> str:
    """HTML of a picture; nothing of none."""
    if data is None:
        return ""
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(data).decode()}">'


def to_pil(data: bytes) -> Any:  # noqa: ANN401
    """A picture's file as a PIL.Image."""
    return needed("PIL.Image", "to_pil()", "pillow").open(io.BytesIO(data))
