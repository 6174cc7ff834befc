"""Enums and parameter trees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

from google.protobuf import json_format
from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
from google.protobuf.message import Message

from ..errors import InvalidArgument
from ..types._value import Name

N = TypeVar("N", bound=Name)
M = TypeVar("M", bound=Message)


class ProtoEnum(Protocol):
    """What the generated enums share."""

    @property
    def DESCRIPTOR(self) -> Any: ...  # noqa: ANN401, N802


def _numbers(enum: ProtoEnum) -> dict[str, int]:
    """Lower-case words without the enum's prefix: {'tracking': 2, ...}."""
    values = enum.DESCRIPTOR.values
    prefix = values[0].name.removesuffix("UNSPECIFIED")
    return {value.name.removeprefix(prefix).lower(): value.number for value in values}


def number(field: str, enum: ProtoEnum, word: str) -> Any:  # noqa: ANN401
    """The number of a word; an unknown one is refused with the list of those that are known."""
    numbers = _numbers(enum)
    found = numbers.get(str(word).lower())
    if found is None:
        words = ", ".join(w for w in numbers if w != "unspecified")
        message = f"{field} is {str(word)!r}; choose one of {words}"
        raise InvalidArgument(message, reason="ENUM_UNKNOWN", field=field)
    return found


def word(kind: type[N], enum: ProtoEnum, value: int) -> N:
    """The word of a number; UNSPECIFIED for those that a newer server may send."""
    words = {n: w for w, n in _numbers(enum).items()}
    try:
        return kind(words.get(value, "unspecified"))
    except ValueError:
        return kind("unspecified")


def message_of(field: str, kind: type[M], tree: Mapping[str, object] | None) -> M:
    """A message of a nested dict with the proto's field names; enums by their words."""
    descriptor: Any = kind.DESCRIPTOR
    try:
        return json_format.ParseDict(_named(field, descriptor, tree or {}), kind())
    except json_format.ParseError as cause:
        message = f"{field} does not fit: {cause}; default_params() shows the names"
        raise InvalidArgument(message, reason="PARAMS_INVALID", field=field) from cause


def set_leaves(tree: Mapping[str, object]) -> tuple[dict[str, object], list[str]]:
    """The tree without what is None, and the dotted paths of all leaves, those with None included."""
    given: dict[str, object] = {}
    paths: list[str] = []
    for name, value in tree.items():
        if isinstance(value, Mapping):
            inner, below = set_leaves(value)
            given[name] = inner
            paths.extend(f"{name}.{path}" for path in below)
            continue
        paths.append(name)
        if value is not None:
            given[name] = value
    return given, paths


def _named(path: str, message: Descriptor, tree: Mapping[str, object]) -> dict[str, object]:
    """The tree with the proto's names in place of words: {'features': 'FEATURE_METHOD_SIFT'} for 'sift'."""
    named: dict[str, object] = {}
    for name, value in tree.items():
        field, inner = message.fields_by_name.get(name), f"{path}.{name}"
        if field is not None and field.enum_type is not None and isinstance(value, str):
            named[name] = _name(inner, field.enum_type, value)
        elif field is not None and field.message_type is not None and isinstance(value, Mapping):
            named[name] = _named(inner, field.message_type, value)
        else:
            named[name] = value
    return named


def _name(field: str, enum: EnumDescriptor, word: str) -> str:
    names = [str(value.name) for value in enum.values]
    found = _words(names).get(word.lower(), word)
    if found not in names:
        known = ", ".join(list(_words(names))[1:])
        message = f"{field} is {word!r}; choose one of {known}"
        raise InvalidArgument(message, reason="ENUM_UNKNOWN", field=field)
    return found


def _words(names: list[str]) -> dict[str, str]:
    """Names of an enum's values by their words."""
    return {name.removeprefix(names[0].removesuffix("UNSPECIFIED")).lower(): name for name in names}


def tree_of(message: Message) -> dict[str, object]:
    """A nested dict of what is set in a message."""
    return {field.name: _plain(field, value) for field, value in message.ListFields()}


def _plain(field: FieldDescriptor, value: Any) -> object:  # noqa: ANN401
    if not isinstance(value, (str, bytes, int, float, Message)):
        return [_plain(field, v) for v in value]
    if isinstance(value, Message):
        return tree_of(value)
    if field.enum_type is not None:
        words = {n: w for w, n in _words([str(v.name) for v in field.enum_type.values]).items()}
        return words[str(field.enum_type.values_by_number[int(value)].name)]
    return value
