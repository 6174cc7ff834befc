#!/usr/bin/env python3
"""Writes lesson.ipynb from lesson.py, so that both cannot differ: runs it, and stores its pictures.

pip install nbformat nbclient ipykernel
PERCEPT_SERVER=127.0.0.1:50051 examples/notebook.py    # a server has to run there
examples/notebook.py --check                           # fails if the notebook's cells are not the script's
"""

from __future__ import annotations

import json
import pathlib
import sys

HERE = pathlib.Path(__file__).resolve().parent
SCRIPT, NOTEBOOK = HERE / "lesson.py", HERE / "lesson.ipynb"


def cells(text):
    """Kind and source of the cells of a script: each begins with a line `# %%`."""
    found = []
    for part in text.split("# %%")[1:]:
        head, _, body = part.partition("\n")
        lines = body.strip("\n").split("\n")
        if "markdown" in head:
            found.append(("markdown", "\n".join(line.removeprefix("#").removeprefix(" ") for line in lines)))
        else:
            found.append(("code", "\n".join(lines)))
    return found


def stored(text):
    """The same of a notebook."""
    return [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]


def main():
    wanted = cells(SCRIPT.read_text())
    if sys.argv[1:] == ["--check"]:
        if stored(NOTEBOOK.read_text()) != wanted:
            sys.exit("lesson.ipynb is not lesson.py: run examples/notebook.py, commit what it writes")
        return
    import nbformat.v4 as nb
    from nbclient import NotebookClient

    make = {"markdown": nb.new_markdown_cell, "code": nb.new_code_cell}
    book = nb.new_notebook(cells=[make[kind](source, id=f"cell-{i}") for i, (kind, source) in enumerate(wanted)])
    book.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    NotebookClient(book, timeout=120, resources={"metadata": {"path": str(HERE)}}, record_timing=False).execute()
    NOTEBOOK.write_text(json.dumps(book, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
