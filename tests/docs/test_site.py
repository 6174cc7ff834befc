"""The documentation's site: docs/site finds what is wrong with it, and every name has a place on a page."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SENSORS = "client-py/src/percept/types/sensors.py"
SERVICE = "proto/percept/v1/maps_service.proto"
#: File, what stands there, what takes its place; the line with the second is wrong then, for the third's reason.
FAULTS = [
    (SENSORS, '"""A sensor of a session.', '"""See `Session.plam`.', "`Session.plam` names what does not exist"),
    (
        SENSORS,
        "\n    kind: SensorKind",
        "\n    colour: int\n    kind: SensorKind",
        "SensorSpec.colour has no docstring",
    ),
    (SERVICE, "  // The map as a file.\n", "", "MapsService.ExportMap has no comment"),
    (
        SERVICE,
        "// Sizes and version,",
        "// See `MapSummary.nothing`,",
        "`MapSummary.nothing` names what does not exist",
    ),
    (
        SERVICE,
        "message ListLoopsRequest {\n",
        "message ListLoopsRequest {\n  bool a = 9;\n",
        "ListLoopsRequest.a has no comment",
    ),
    ("README.md", "# percept\n", "# percept\n[a](docs/none.md)\n", "docs/none.md leads nowhere"),
    ("SECURITY.md", "# ", "[b](README.md#no-such)\n\n# ", "README.md#no-such has no such heading"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The site of a copy of the tree with faults, and what is said of it."""
    tree = tmp_path_factory.mktemp("tree")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    wanted = re.compile(r"proto/|client-py/|docs/|examples/|.*\.md$|.*/rest/routes\.rs$")
    for name in filter(wanted.match, tracked.splitlines()):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tree / name)
    for name, there, instead, _ in FAULTS:
        text = (tree / name).read_text()
        assert there in text, (name, there)
        (tree / name).write_text(text.replace(there, instead, 1))
    subprocess.run(["git", "init", "-q"], cwd=tree, check=True)
    subprocess.run(["git", "add", "."], cwd=tree, check=True)
    said = subprocess.run([tree / "docs/site", tree / "out"], capture_output=True, text=True)
    return tree, said


def test_what_is_wrong_is_told_by_file_and_line(built):
    tree, said = built
    assert said.returncode == 1, said.stderr
    told = [re.fullmatch(r"([^:]+):(\d+): (.*)", line) for line in said.stderr.splitlines()]
    assert sorted((m[1], m[3]) for m in told) == sorted((name, what) for name, _, _, what in FAULTS)
    for name, line, what in (m.groups() for m in told):
        subject = re.search(r"[\w./#-]+", what)[0].split(".")[-1]
        assert subject.split("#")[-1] in (tree / name).read_text().splitlines()[int(line) - 1], (name, line, what)


def test_classes_rpcs_fields_and_requests_are_on_pages(built):
    site = built[0] / "out"
    for page, name in [
        ("percept/_sync/session", "Session.plan"),
        ("percept/types/sensors", "SensorSpec.range_max_m"),
        ("percept/v1/navigation_service", "NavigationService.PlanPath"),
        ("percept/v1/sensor", "SensorSpec.range_max_m"),
        ("docs/reasons", "not_found"),
        ("rest", "sessions"),
    ]:
        assert f'id="{name}"' in (site / f"{page}.html").read_text(), (page, name)
    fields = (site / "percept/types/sensors.html").read_text()
    assert "How far it sees, metres" in fields and "Nanoseconds" in (site / "percept/types/frames.html").read_text()


def test_every_link_leads_to_a_page_and_a_place_on_it(built):
    site = built[0] / "out"
    pages = {path: path.read_text() for path in site.rglob("*.html")}
    places = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in pages.items()}
    astray = []
    for path, text in pages.items():
        for link in re.findall(r'\b(?:href|src)="(?!\w+:)([^"$]*)"', text):
            name, _, place = link.partition("#")
            target = (path.parent / name).resolve() if name else path
            if not target.exists() or (place and place not in places.get(target, [place])):
                astray.append((path.relative_to(site).as_posix(), link))
    assert sorted(astray) == [("README.html", "docs/none.html"), ("SECURITY.html", "README.html#no-such")]
