"""The Python client as pages: its modules in, as pdoc reads them, with what pdoc leaves out."""

from __future__ import annotations

import ast
import enum
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator, Mapping

import pdoc.doc
import percept
from pdoc.doc import Class, Function, Module, Variable

#: Modules behind the public ones that hold what users call: what `Client` and `Session` give, and its bases.
REACHED = r"percept\.(_sync|_async)\.(?!_|transport$)|percept\._sender$"
PUBLIC = r"percept\.(types|errors|plot|zenoh)(\.(?!_)\w+)*$"


def modules() -> dict[str, Module]:
    """By name; `percept` itself has its names as a table."""
    names = [m.name for m in pkgutil.walk_packages(percept.__path__, "percept.")]
    found = {name: Module.from_name(name) for name in names if re.match(f"{REACHED}|{PUBLIC}", name)}
    for module in found.values():
        for name, doc in list(module.members.items()):
            if not _is_shown(module, name, doc):
                del module.members[name]
        for doc in (module, *classes(module)):
            _take_comments(doc)
        for doc in members(module):
            doc.docstring = _with_lists(doc)
    return {name: module for name, module in found.items() if module.members}


def _is_shown(module: Module, name: str, doc: pdoc.doc.Doc) -> bool:
    if doc.taken_from[0] != module.modulename or getattr(doc, "is_typevar", False):
        return False
    if name.startswith("_"):
        # What a public class inherits from one that is not is public.
        public = [other.obj for other in classes(module) if not other.name.startswith("_")]
        if not isinstance(doc, Class) or not any(doc.obj in kind.__bases__ for kind in public):
            return False
        doc.docstring += "\n\n@public"
    return isinstance(doc, Class) or not re.match(REACHED, module.modulename)


def classes(module: Module) -> Iterator[Class]:
    """The classes of a module."""
    return (doc for doc in module.members.values() if isinstance(doc, Class))


def members(module: Module) -> Iterator[pdoc.doc.Doc]:
    """What a module documents, and what its classes do, without what they inherit."""
    for doc in module.members.values():
        yield doc
        if isinstance(doc, Class):
            yield from (m for m in doc.members.values() if not m.is_inherited)


def _take_comments(doc: Class | Module) -> None:
    """Comments that begin with `#:` are the docstrings of what is below them."""
    lines = textwrap.dedent(inspect.getsource(doc.obj)).splitlines()
    for node in ast.walk(ast.parse("\n".join(lines))):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            member = doc.members.get(getattr(target, "id", "") or getattr(target, "attr", ""))
            above, words = node.lineno - 2, []
            while lines[above].strip().startswith("#:"):
                words.insert(0, lines[above].strip()[2:].strip())
                above -= 1
            if words and isinstance(member, Variable):
                member.docstring = "\n".join(words)


def _with_lists(doc: pdoc.doc.Doc) -> str:
    """Lines that begin with a parameter and a colon become a list."""
    if not isinstance(doc, Function) or not doc.signature.parameters:
        return doc.docstring
    names = "|".join(map(re.escape, doc.signature.parameters))
    return re.sub(rf"(?m)^((?:{names})(?:, (?:{names}))*): ", r"- **\1**: ", doc.docstring)


def undocumented(module: Module, comments: Mapping[str, str]) -> Iterator[pdoc.doc.Doc]:
    """What nothing is said about: not by itself, its class, its type, nor by the contract's field of that name,
    whose words it takes then."""
    for doc in members(module):
        name = doc.name
        outer = module.members.get(doc.qualname.rpartition(".")[0])
        if doc.docstring or name.startswith("_") or getattr(doc, "is_typevar", False):
            continue
        if isinstance(outer, Class) and isinstance(doc, Variable):
            is_inherited = any(name in vars(base) for base in outer.obj.__mro__[1:])
            if is_inherited or issubclass(outer.obj, enum.Enum) or re.search(rf"\b{name}\b", outer.docstring):
                continue
            doc.docstring = comments.get(f"{outer.name}.{name}", "")
            if doc.docstring or re.search(r"percept\.types\.\w+\.\w+", doc.annotation_str):
                continue
        yield doc
