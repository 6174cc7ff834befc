"""Answers that come in parts, as one: the rule stands in the contract's toolbox.proto."""

from __future__ import annotations

from typing import TypeVar

from google.protobuf.message import Message

M = TypeVar("M", bound=Message)


def joined(parts: list[M]) -> M:
    """Bytes and lists go on from part to part; all else stands in the first."""
    head = parts[0]
    if len(parts) > 1:
        _join(head, parts[1:])
    return head


def _join(head: Message, rest: list[M]) -> None:
    for field in head.DESCRIPTOR.fields:
        name = field.name
        mine = getattr(head, name)
        theirs = [getattr(part, name) for part in rest]
        if isinstance(mine, bytes):
            if any(theirs):
                setattr(head, name, b"".join([mine, *theirs]))
        elif isinstance(mine, Message):
            there = [part for part, whole in zip(theirs, rest, strict=True) if whole.HasField(name)]
            if there:
                _join(mine, there)
        elif hasattr(mine, "MergeFrom"):
            for more in theirs:
                mine.MergeFrom(more)
    if head.DESCRIPTOR.name == "PointCloud":
        # A part of a cloud is a cloud, which counts its own points.
        setattr(head, "num_points", sum(getattr(cloud, "num_points") for cloud in [head, *rest]))  # noqa: B009, B010
