"""Builds the site: the tree and a folder in, pages out; says what is wrong with them."""

from __future__ import annotations

import inspect
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import types
from collections.abc import Iterator

import pdoc.doc
import pdoc.render
import percept
from markupsafe import Markup
from pdoc import render_helpers
from pdoc.doc import Doc, Module

from . import client
from .contract import Contract
from .references import References

ROUTE = re.compile(r'^    (get|post|patch|delete)\("([^"]+)", "(\w+/\w+)"', re.M)
LINK = re.compile(r"(\[[^\]]*\])\(([^)\s]+)\)")
ARRAY = re.compile(r"numpy\.ndarray\[tuple\[typing\.Any, \.\.\.\], numpy\.dtype\[(?:numpy\.|typing\.)?(\w+)\]\]")
NAMED = {"rest": "REST", "docs.reasons": "Reasons", "ARCHITECTURE": "Architecture", "docs.measured": "Measured"}

#: Of the pages of the client: what comes last, last but one...
ORDER = ("_async", ".types", "_sender", "bound", "pages")

#: What no other folder has in it.
MARK = "search.js"

Problem = tuple[str, int, str]


def page(name: str, text: str) -> Module:
    """Markdown as a page."""
    return Module(types.ModuleType(name, text))


def first(text: str) -> str:
    """The first sentence, for a cell of a table."""
    words = re.split(r"(?<=[.;])\s", " ".join(text.split("\n\n")[0].split()))[0]
    return words.rstrip(".;:").replace("|", "\\|") + "."


def short(code: str) -> str:
    """Links with the last name of a thing as their text."""
    return re.sub(r"(?<=>)percept\.[\w.]*?(\w+)(?=</a>)", r"\1", code)


def table(docs: list[tuple[str, Doc]]) -> str:
    """Names with what they are, by the page that they are on."""
    shown = [(url, doc) for url, doc in docs if not doc.name.startswith("_")]
    rows = [f"| [`{doc.name}`]({url}#{doc.qualname}) | {first(doc.docstring)} |" for url, doc in shown]
    return "\n".join(["| | |", "| --- | --- |", *rows, ""])


class Site:
    """All pages, by name."""

    def __init__(self, root: pathlib.Path, scratch: pathlib.Path) -> None:
        self.root = root
        command = ["git", "ls-files", "*.md", ":!docs/pages"]
        listed = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
        routes = ROUTE.findall((root / "server/percept/src/doors/rest/routes.rs").read_text())
        self.routes = {rpc: f"{verb.upper()} {path}" for verb, path, rpc in routes}
        self.contract = Contract(root / "proto", scratch, self.routes)
        self.client = client.modules()
        self.protos = {m.__name__: Module(m) for m in self.contract.modules}
        self.references = References({**self.client, **self.protos})
        self.texts = {p.removesuffix(".md").replace("/", "."): p for p in listed.splitlines()}
        # Before anything is written: what has no docstring takes the contract's words.
        self.unsaid = [
            (module, doc)
            for module in self.client.values()
            for doc in client.undocumented(module, self.contract.comments)
        ]
        self.modules = {**self.client, **self.protos}
        self.modules |= {name: page(name, self._moved(root / path)) for name, path in self.texts.items()}
        self.modules["examples.lesson"] = page("examples.lesson", self._lesson())
        self.modules["percept"] = page("percept", self._front_of_client())
        self.modules["percept.v1"] = page("percept.v1", self._front_of_contract())
        self.modules["rest"] = page("rest", self._rest())
        self.modules["index"] = page("index", (root / "docs/pages/index.md").read_text())

    @staticmethod
    def _moved(path: pathlib.Path) -> str:
        """A file's text with its links between files as links between pages."""

        def moved(match: re.Match[str]) -> str:
            name, _, anchor = match[2].partition("#")
            if name and (path.parent / name).is_dir():
                name = "percept/v1.html" if name == "proto/percept/v1" else f"{name}/README.html"
            name = re.sub(r"\.(md|ipynb)$", ".html", name)
            return f"{match[1]}({name}{anchor and '#'}{anchor})"

        return LINK.sub(moved, path.read_text())

    def _front_of_client(self) -> str:
        parts = ["# Python", percept.__doc__ or "", "See also [how it is used](client-py/README.html)."]
        for name, module in sorted(self.client.items(), key=lambda m: (*(word in m[0] for word in ORDER), m[0])):
            docs = [(f"{name.replace('.', '/')}.html", doc) for doc in module.members.values()]
            parts += [f"## {title(name)}", first(module.docstring), table(docs)]
        return "\n\n".join(parts)

    def _front_of_contract(self) -> str:
        about = "The package `percept.v1`, one file a page: services, then the messages that several of them share."
        parts = ["# gRPC", f"{about} How it is called is in [README.md](../README.html#grpc)."]
        for name, module in sorted(self.protos.items(), key=lambda m: not m[0].endswith("_service")):
            docs = [(f"v1/{name.split('.')[-1]}.html", doc) for doc in module.members.values() if doc.docstring]
            parts += [f"## {name.split('.')[-1]}.proto", table(docs)]
        return "\n\n".join(parts)

    def _rest(self) -> str:
        about = (
            "Each request is an rpc, whose page says what its fields mean; bodies and answers are the messages' JSON."
        )
        more = "A server describes all of them at `/openapi.json` (OpenAPI 3.1), to be tried at `/docs`."
        parts = [f"# REST\n\n{about} {more} Examples are in [README.md](README.html#rest)."]
        for service in dict.fromkeys(rpc.split("/")[0] for rpc in self.routes):
            parts.append(f"\n## {service.removesuffix('Service')}\n\n| request | | rpc |\n| --- | --- | --- |")
            for rpc, route in self.routes.items():
                name = rpc.replace("/", ".")
                if rpc.startswith(f"{service}/"):
                    home = self.references.named[name][0].modulename.replace(".", "/")
                    about = first(self.contract.comments[name])
                    parts.append(f"| `{route}` | {about} | [{rpc.split('/')[1]}]({home}.html#{name}) |")
        return "\n".join(parts)

    def _lesson(self) -> str:
        parts = []
        for cell in json.loads((self.root / "examples/lesson.ipynb").read_text())["cells"]:
            text = "".join(cell["source"])
            parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
            for output in cell.get("outputs", []):
                data = output.get("data", {})
                text = "".join(output.get("text", data.get("text/plain", "")))
                picture = data.get("image/png")
                parts.append(f"![](data:image/png;base64,{picture.strip()})" if picture else f"```text\n{text}\n```")
        return "\n\n".join(parts)

    def build(self, out: pathlib.Path) -> None:
        """Writes every page, and what the Markdown files show."""
        pdoc.render.configure(
            docformat="markdown", show_source=False, template_directory=self.root / "docs/pages/templates"
        )
        plain = pdoc.doc.formatannotation
        # The one is of results, the other of parameters.
        pdoc.doc.formatannotation = inspect.formatannotation = lambda *a, **k: ARRAY.sub(r"NDArray[\1]", plain(*a, **k))
        pdoc.render.env.filters["linkify"] = self._linkify()
        pdoc.render.env.filters["link"] = pdoc.render.jinja2.pass_context(
            lambda *a, **k: Markup(short(render_helpers.link(*a, **k)))
        )
        pdoc.render.env.globals.update(title=title, chapters=NAMED)
        for name, module in self.modules.items():
            target = out / f"{name.replace('.', '/')}.html"
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(pdoc.render.html_module(module, self.modules))
        searched = {name: m for name, m in self.modules.items() if "_async" not in name and name != "index"}
        (out / MARK).write_text(pdoc.render.search_index(searched))
        for path in self.texts.values():
            for link, _ in self._links(path):
                source = (self.root / path).parent / link.split("#")[0]
                if source.is_file() and source.suffix != ".md":
                    target = out / source.resolve().relative_to(self.root)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy(source, target)

    def _linkify(self):  # noqa: ANN202
        @pdoc.render.jinja2.pass_context
        def filtered(context, code: str, namespace: str = "", shorten: bool = True) -> Markup:  # noqa: ANN001
            here = context["module"].modulename
            if shorten:
                code = render_helpers.linkify(context, code, namespace, shorten)
                return Markup(short(code))
            return Markup(re.sub(r"(?<!\">)<code>([^<]+)</code>", lambda m: self._linked(m, here, namespace), code))

        return filtered

    def _linked(self, match: re.Match[str], here: str, scope: str) -> str:
        found = self.references.find(match[1], here, scope)
        if not isinstance(found, tuple):
            return match[0]
        url = render_helpers.relative_link(here, found[0]) + (f"#{found[1]}" if found[1] else "")
        return f'<a href="{url}">{match[0]}</a>'

    def problems(self, out: pathlib.Path) -> Iterator[Problem]:
        """What is wrong: file, line, what."""
        yield from self.contract.problems
        for module, doc in self.unsaid:
            if "_sync" not in module.modulename:
                yield *self._place(module, doc, doc.name), f"{doc.qualname} has no docstring"
        for name, module in {**self.client, **self.protos}.items():
            if "_sync" not in name:
                for doc in (module, *client.members(module)):
                    for text in re.findall(r"`([^`\n]+)`", doc.docstring):
                        if self.references.find(text, name, doc.qualname) is None:
                            yield *self._place(module, doc, text), f"`{text}` names what does not exist"
        for path in self.texts.values():
            for link, line in self._links(path):
                if wrong := self._wrong(path, link, out):
                    yield path, line, f"{link} {wrong}"

    def _place(self, module: Module, doc: Doc, text: str) -> tuple[str, int]:
        """The first line with the text from where the thing, or what it is in, begins; a proto's comment is above."""
        if module.modulename in self.protos:
            proto, at = self.contract.places[doc.qualname]
            lines = (self.root / proto).read_text().splitlines()[:at]
            return proto, next((i for i in range(at, 0, -1) if text in lines[i - 1]), at)
        path = pathlib.Path(module.obj.__file__ or "")
        outer = module.members.get(doc.qualname.split(".")[0], module)
        start = max(1, (doc.source_lines or outer.source_lines or (1, 1))[0])
        lines = path.read_text().splitlines()[start - 1 :]
        line = next((i for i, words in enumerate(lines, start) if text in words), start)
        return str(path.relative_to(self.root)), line

    def _links(self, path: str) -> Iterator[tuple[str, int]]:
        fenced = False
        for i, line in enumerate((self.root / path).read_text().splitlines(), 1):
            fenced ^= line.startswith("```")
            if not fenced:
                yield from ((link, i) for _, link in LINK.findall(line) if not re.match(r"\w+:", link))

    def _wrong(self, path: str, link: str, out: pathlib.Path) -> str:
        name, _, anchor = link.partition("#")
        target = ((self.root / path).parent / name).resolve() if name else self.root / path
        if not target.exists():
            return "leads nowhere"
        built = (out / target.relative_to(self.root)).with_suffix(".html")
        if anchor and target.suffix == ".md" and f'id="{anchor}"' not in built.read_text():
            return "has no such heading"
        return ""


def title(name: str) -> str:
    """A page's name as people read it."""
    stem = name.split(".")[-1] if "toolbox." not in name else "toolbox, " + name.split(".")[-1]
    if name.startswith(("percept._async", "percept._sync", "percept._sender")):
        return f"percept: {stem.strip('_')}{', for asyncio' if '_async' in name else ''}"
    return NAMED.get(name, name)


def main() -> int:
    """Builds, and tells what is wrong."""
    root, out = (pathlib.Path(argument).resolve() for argument in sys.argv[1:])
    if out.exists() and any(out.iterdir()):
        if not (out / MARK).exists():
            print(f"{out} holds something else than a site; name another folder", file=sys.stderr)
            return 2
        shutil.rmtree(out)
    with tempfile.TemporaryDirectory() as scratch:
        site = Site(root, pathlib.Path(scratch))
        site.build(out)
        problems = sorted(set(site.problems(out)))
    for path, line, what in problems:
        print(f"{path}:{line}: {what}", file=sys.stderr)
    print(f"{len(site.modules)} pages: {out / 'index.html'}")
    return min(len(problems), 1)


if __name__ == "__main__":
    sys.exit(main())
