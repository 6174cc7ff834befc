"""References: what stands in backticks in, the page that it is on out."""

from __future__ import annotations

import builtins
import enum
import re
from collections.abc import Iterable

from pdoc.doc import Class, Doc, Function, Module

#: Names of others, and of poses: t_a_b.
FOREIGN = r"(np|numpy|DracoPy|asyncio|grpc|google|matplotlib)\b|t_[a-z]+_[a-z]+$"


class References:
    """All that has a place on a page, by its name."""

    def __init__(self, modules: dict[str, Module]) -> None:
        self.modules = modules
        self.named: dict[str, list[Doc]] = {}
        self.words: set[str] = set(dir(builtins))
        for module in modules.values():
            self._add(module.members.values())

    def _add(self, docs: Iterable[Doc]) -> None:
        for doc in docs:
            self.named.setdefault(doc.qualname, []).append(doc)
            self.words.add(doc.name)
            if isinstance(doc, Function):
                self.words |= {*doc.signature.parameters}
            if isinstance(doc, Class):
                self._add(doc.members.values())
                self.words |= {str(v.value) for v in vars(doc.obj).values() if isinstance(v, enum.Enum)}

    def find(self, text: str, module: str, scope: str) -> tuple[str, str] | bool | None:
        """Module and name on its page; True for what is known and has none, or is no reference; None for what
        does not exist."""
        name = re.sub(r"\(.*", "", text)
        if not re.fullmatch(r"[A-Za-z]\w*(\.[A-Za-z]\w*)*", name) or re.match(FOREIGN, name):
            return True
        if name in self.modules:
            return name, ""
        parts = scope.split(".")
        near = [".".join([*parts[:n], name]) for n in range(len(parts), -1, -1)]
        for candidate in (*near, re.sub(r"^percept\.(\w+\.(?=\w))*?(?=[A-Z]|\w+$)", "", name)):
            docs = self.named.get(candidate, [])
            if candidate == name and re.fullmatch("[a-z_0-9]+", name):
                # A word may be anything elsewhere.
                docs = [doc for doc in docs if doc.modulename == module]
            if docs:
                doc = min(docs, key=lambda d: self._distance(d.modulename, module))
                return doc.taken_from if doc.taken_from[0] in self.modules else True
        # One word is a name if it looks like one; several are if the first is a class's or the package's.
        is_name = re.match(r"[A-Z]\w*[a-z]\w*\.|percept\.|[A-Z][a-z]+[A-Z]\w*$|[a-z]+_\w+$", name)
        return None if is_name and name not in self.words else True

    @staticmethod
    def _distance(module: str, other: str) -> tuple[bool, ...]:
        """Of pages that have something of the name the nearest counts."""
        return module != other, *(word in module and word not in other for word in (".v1.", "_async")), "_sync" in other
