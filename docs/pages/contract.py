"""The contract as pages: protos in, modules for pdoc out, in which a field reads as it does in its proto."""

from __future__ import annotations

import importlib
import pathlib
import re
import subprocess
from collections.abc import Iterator

import percept.v1
from google.protobuf import descriptor_pb2 as pb

Field = pb.FieldDescriptorProto
SCALARS = {number: name.removeprefix("TYPE_").lower() for name, number in Field.Type.items()}
#: Words of protos as classes, with their bases; as builtins they are shown without the name of a module.
WORDS = dict.fromkeys([*SCALARS.values(), "Status", "FieldMask"], "") | dict.fromkeys(
    ["repeated", "optional", "stream"], "Generic[T]"
)
HEAD = "from typing import Generic, TypeVar\nT, U = TypeVar('T'), TypeVar('U')\n"
MAP = "class map(Generic[T, U]):\n    __module__ = 'builtins'\n"
MODULE = "from __future__ import annotations\nfrom percept.v1.words import *\n__all__ = "


class Contract:
    """All protos of a folder, with the request of the REST door for each rpc."""

    def __init__(self, folder: pathlib.Path, scratch: pathlib.Path, routes: dict[str, str]) -> None:
        self.routes = routes
        #: Comments, and files with lines, by name: SensorSpec.kind.
        self.comments: dict[str, str] = {}
        self.places: dict[str, tuple[str, int]] = {}
        self.problems: list[tuple[str, int, str]] = []
        self._rpcs: dict[str, str] = {}
        words = [f"class {name}({bases}):\n    __module__ = 'builtins'" for name, bases in WORDS.items()]
        (scratch / "words.py").write_text(HEAD + MAP + "\n".join(words))
        compiled = scratch / "contract.binpb"
        protos = sorted(folder.glob("percept/v1/*.proto"))
        options = ["--include_source_info", f"--descriptor_set_out={compiled}"]
        subprocess.run(["protoc", f"-I{folder}", *options, *protos], check=True)
        for file in pb.FileDescriptorSet.FromString(compiled.read_bytes()).file:
            lines = "\n".join(self._file(file))
            names = [kind.name for kind in (*file.service, *file.message_type, *file.enum_type)]
            text = f"{f'`{file.name}`'!r}\n{MODULE}{names!r}\n{lines}"
            (scratch / pathlib.Path(file.name).with_suffix(".py").name).write_text(text)
        percept.v1.__path__.append(str(scratch))
        self.modules = [importlib.import_module(f"percept.v1.{proto.stem}") for proto in protos]
        every = {name: vars(module)[name] for module in self.modules for name in module.__all__}
        for module in self.modules:
            vars(module).update(every)

    def _file(self, file: pb.FileDescriptorProto) -> Iterator[str]:
        """A module's lines."""
        places = {tuple(place.path): place for place in file.source_code_info.location}

        def about(path: tuple[int, ...], name: str, more: str = "", is_told: bool = False) -> str:
            """A name's comment; where there is none, something else has to tell."""
            place = places[path]
            words = re.sub(r"(?m)^ ", "", place.leading_comments or place.trailing_comments).strip()
            self.comments[name], self.places[name] = words, (f"proto/{file.name}", place.span[0] + 1)
            if not words and not is_told:
                self.problems.append((*self.places[name], f"{name} has no comment"))
            return repr("\n\n".join(filter(None, (words, more))))

        def message(kind: pb.DescriptorProto, path: tuple[int, ...], outer: str) -> Iterator[str]:
            name, indent = outer + kind.name, "    " * (outer.count(".") + 1)
            # What an rpc takes or answers is told by the rpc, a field of a message or enum by that.
            rpc = self._rpcs.get(name)
            yield f"{indent[4:]}class {kind.name}:\n{indent}{about(path, name, rpc and f'Of `{rpc}`.', rpc)}"
            for i, field in enumerate(kind.field):
                word, is_map = _type(kind, field)
                is_choice = field.HasField("oneof_index") and not field.proto3_optional
                choice = f"One of *{kind.oneof_decl[field.oneof_index].name}*." if is_choice else ""
                is_told = bool(field.type_name) and not is_map
                words = about((*path, 2, i), f"{name}.{field.name}", choice, is_told)
                yield f"{indent}{field.name}: {word} = {field.number}\n{indent}{words}"
            for i, words in enumerate(kind.enum_type):
                yield from enum(words, (*path, 4, i), f"{name}.")
            for i, nested in enumerate(kind.nested_type):
                if not nested.options.map_entry:
                    yield from message(nested, (*path, 3, i), f"{name}.")

        def enum(kind: pb.EnumDescriptorProto, path: tuple[int, ...], outer: str) -> Iterator[str]:
            name, indent = outer + kind.name, "    " * (outer.count(".") + 1)
            yield f"{indent[4:]}class {kind.name}:\n{indent}{about(path, name)}"
            for i, value in enumerate(kind.value):
                words = about((*path, 2, i), f"{name}.{value.name}", is_told=True)
                yield f"{indent}{value.name} = {value.number}\n{indent}{words}"

        for i, service in enumerate(file.service):
            yield f"class {service.name}:\n    {about((6, i), service.name)}"
            for j, rpc in enumerate(service.method):
                name, route = f"{service.name}.{rpc.name}", self.routes.get(f"{service.name}/{rpc.name}")
                given, answer = (kind.split(".")[-1] for kind in (rpc.input_type, rpc.output_type))
                self._rpcs |= {given: name, answer: name}
                given = f"stream[{given}]" if rpc.client_streaming else given
                answer = f"stream[{answer}]" if rpc.server_streaming else answer
                words = about((6, i, 2, j), name, route and f"REST: `{route}`")
                yield f"    def {rpc.name}(request: {given}) -> {answer}:\n        {words}"
        for i, kind in enumerate(file.message_type):
            yield from message(kind, (4, i), "")
        for i, words in enumerate(file.enum_type):
            yield from enum(words, (5, i), "")


def _type(kind: pb.DescriptorProto, field: Field) -> tuple[str, bool]:
    """The type of a field, and whether it is a map."""
    name = field.type_name
    if entry := next((n for n in kind.nested_type if n.options.map_entry and name.endswith(f".{n.name}")), None):
        return f"map[{', '.join(_type(kind, f)[0] for f in entry.field)}]", True
    ours = name.startswith(".percept.v1.")
    word = (name.removeprefix(".percept.v1.") if ours else name.split(".")[-1]) or SCALARS[field.type]
    if field.label == Field.LABEL_REPEATED:
        return f"repeated[{word}]", False
    return (f"optional[{word}]" if field.proto3_optional else word), False
