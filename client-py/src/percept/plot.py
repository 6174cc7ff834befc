"""Plots with matplotlib: `pip install 'percept[plot]'`. Each gives matplotlib axes in metres, seen from
above, with labels, a scale bar and a legend; with `axes` it draws over what is there.

    axes = percept.plot.occupancy(session.map.occupancy())
    percept.plot.trajectory(session.trajectory(), axes=axes)
    percept.plot.path(session.plan((2.0, 1.0)), axes=axes)
    axes.figure.savefig("map.png")

`session.plot()` draws what a session has mapped, all at once.

Without matplotlib they raise ImportError.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from ._arrays import Array
from ._optional import needed
from .errors import WrongType
from .types.cloud import Labels, PointCloud, labels_of
from .types.evaluation import PosePairs, TrajectoryMetrics
from .types.exploration import CoveragePath, FlightPath
from .types.geometry import OrientedBox
from .types.maps import MapCloud, OccupancyGrid
from .types.navigation import GridMap, NoPath, Path
from .types.scene import Object, SceneGraph, SceneNodeKind
from .types.sessions import Trajectory

__all__ = ["cloud", "objects", "occupancy", "path", "scene", "session", "trajectories", "trajectory"]

Floats = npt.NDArray[np.float64]
#: More points than this are thinned evenly: a picture of a few hundred thousand pixels shows no more.
MAX_POINTS = 200_000


def _figure(layout: str, size: tuple[float, float]) -> Any:  # noqa: ANN401
    module = needed("matplotlib.figure", "percept.plot", "percept[plot]")

    # Not pyplot: no window, no global state. So it has to show itself in a notebook.
    class Figure(module.Figure):  # type: ignore[misc, name-defined]
        def _repr_png_(self) -> bytes:
            out = io.BytesIO()
            self.savefig(out, format="png", dpi=90)
            return out.getvalue()

    return Figure(layout=layout, figsize=size)


def _axes(axes: Any, across: str = "xy", title: str = "") -> Any:  # noqa: ANN401
    """Those that were given, or new ones in metres."""
    if axes is None:
        axes = _figure("compressed", (7, 6)).add_subplot()
        axes.set(title=title)
    axes.set(xlabel=f"{across[0]} [m]", ylabel=f"{across[1]} [m]", aspect="equal")
    return axes


def _finished(axes: Any) -> Any:  # noqa: ANN401
    """A scale bar of a round length, a quarter of the width or less, and the legend, below the drawing."""
    for old in [artist for artist in axes.texts if artist.get_gid() == "scale"]:
        old.remove()
    inside = {"transform": axes.transAxes, "gid": "scale", "ha": "center"}
    if not np.isfinite(axes.dataLim.get_points()).all():
        axes.set(xlim=(0, 1), ylim=(0, 1))
        axes.text(0.5, 0.5, "empty", va="center", **inside)
    # A straight drive would else be drawn on a line without height.
    axes.autoscale_view()
    spans = [abs(high - low) for low, high in (axes.get_xlim(), axes.get_ylim())]
    for name, span in zip("xy", spans, strict=True):
        if span < 0.3 * max(spans):
            middle = sum(getattr(axes, f"get_{name}lim")()) / 2
            widen = getattr(axes, f"set_{name}lim")
            # Whatever is drawn over it may make it larger.
            widen(middle - 0.15 * max(spans), middle + 0.15 * max(spans), auto=None)
    low, high = sorted(axes.get_xlim())
    longest = (high - low) / 4
    decade = 10.0 ** math.floor(math.log10(longest))
    length = max(n * decade for n in (1, 2, 5) if n * decade <= longest)
    left = 0.97 - length / (high - low)
    arrow = {"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "shrinkA": 0, "shrinkB": 0, **_haloed("tab:red")}
    where = {"xycoords": "axes fraction", "textcoords": "axes fraction"}
    axes.annotate("", xy=(left, 0.03), xytext=(0.97, 0.03), **where, arrowprops=arrow, gid="scale", zorder=9)
    style = {"va": "bottom", "fontweight": "bold", "zorder": 9, **_haloed("tab:red")}
    axes.text((left + 0.97) / 2, 0.045, f"{length:g} m", **style, **inside)
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    if once:
        transforms = needed("matplotlib.transforms", "percept.plot", "percept[plot]")
        # Below the label of the x axis, however high the drawing is.
        below = transforms.offset_copy(axes.transAxes, axes.figure, y=-38, units="points")
        style = {"loc": "upper left", "bbox_to_anchor": (0, 0), "bbox_transform": below, "borderaxespad": 0}
        axes.legend(once.values(), once.keys(), ncols=4, fontsize="small", **style)
    return axes


def _haloed(colour: str) -> dict[str, Any]:
    """A colour that is seen on white and black."""
    effects = needed("matplotlib.patheffects", "percept.plot", "percept[plot]")
    return {"color": colour, "path_effects": [effects.withStroke(linewidth=3, foreground="white")]}


def occupancy(grid: OccupancyGrid | GridMap, *, axes: Any = None) -> Any:  # noqa: ANN401
    """Cells of a map: white free, black occupied, grey in between, light blue unknown."""
    colours = needed("matplotlib.colors", "percept.plot", "percept[plot]")
    axes = _axes(axes, title="Occupancy")
    cells = np.asarray(grid.cells)
    if cells.size:
        (x, y), (height, width) = grid.origin, cells.shape
        edges = (x, x + width * grid.resolution_m, y, y + height * grid.resolution_m)
        shown = np.ma.masked_less(cells, 0)
        shades = colours.LinearSegmentedColormap.from_list("occupancy", ["white", "black"])
        style = {"cmap": shades.with_extremes(bad="#cfe3f2"), "vmin": 0, "vmax": 100, "zorder": 0}
        axes.imshow(shown, origin="lower", extent=edges, **style)
    for label, colour in (("free", "white"), ("occupied", "black"), ("unknown", "#cfe3f2")):
        axes.scatter([], [], marker="s", color=colour, edgecolors="0.5", label=label)
    return _finished(axes)


def trajectory(way: Trajectory, *, axes: Any = None) -> Any:  # noqa: ANN401
    """Where base was, from its first frame (circle) to its last (cross); frames that were lost in red."""
    axes = _axes(axes, title=f"Trajectory, {way.length_m:.1f} m")
    x, y = way.positions[:, 0], way.positions[:, 1]
    axes.plot(x, y, color="tab:blue", label="trajectory")
    lost = np.array([state == "lost" for state in way.states], bool)
    if lost.any():
        axes.scatter(x[lost], y[lost], s=12, color="tab:red", label="lost", zorder=3)
    axes.scatter(x[:1], y[:1], marker="o", color="tab:blue", label="first", zorder=3)
    axes.scatter(x[-1:], y[-1:], marker="x", color="tab:blue", label="last", zorder=3)
    return _finished(axes)


def session(
    name: str,
    grid: OccupancyGrid,
    way: Trajectory,
    things: Iterable[Object],
    *,
    axes: Any = None,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """What a session has mapped: cells, trajectory, things. `session.plot()` asks for them and draws this."""
    axes = occupancy(grid, axes=axes)
    if len(way.positions):
        trajectory(way, axes=axes)
    objects(things, axes=axes)
    axes.set(title=f"{name}, {way.length_m:.1f} m")
    return axes


def path(found: Path | CoveragePath | FlightPath | NoPath, *, axes: Any = None) -> Any:  # noqa: ANN401
    """A path from start (circle) to goal (star), stretches that are driven backwards dashed; of no path, what
    blocks it, if that is known, and the reason as the title."""
    if isinstance(found, NoPath):
        axes = _axes(axes)
        axes.set(title=f"no path: {found.detail or found.reason}")
        if found.blocking is not None:
            axes.scatter(
                *found.blocking.obstacle, marker="X", color="tab:red", label="blocks the way", zorder=4
            )
        return _finished(axes)
    found = found.path if isinstance(found, CoveragePath) else found
    axes = _axes(axes, title=f"Path, {found.length_m:.2f} m")
    points = found.waypoints
    axes.plot(points[:, 0], points[:, 1], color="tab:purple", label="path", zorder=3)
    if isinstance(found, Path) and found.is_reverse.any():
        for i in np.flatnonzero(found.is_reverse[:-1]):
            axes.plot(*points[i : i + 2, :2].T, color="white", linestyle=":", zorder=4)
        axes.plot([], [], color="tab:purple", linestyle=":", label="backwards")
    axes.scatter(*points[0, :2], marker="o", color="tab:green", label="start", zorder=4)
    axes.scatter(*points[-1, :2], marker="*", s=90, color="tab:purple", label="goal", zorder=4)
    return _finished(axes)


def cloud(
    points: PointCloud | MapCloud | Array,
    *,
    labels: Labels | None = None,
    across: str = "xy",
    axes: Any = None,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """A cloud, or its points (N, 3) float32, seen along the axis that `across` leaves out (xy: from above),
    coloured by labels (those of clusters, say; none in grey), else in its own colours, else by that axis.
    Points that are not finite are left out, and of more than 200000 as many are drawn."""
    if isinstance(points, MapCloud):
        points = points.cloud
    points = points if isinstance(points, PointCloud) else PointCloud(points)
    if len(across) != 2 or not set(across) < set("xyz") or across[0] == across[1]:
        raise WrongType(f"across is {across!r}; give two of x, y, z", reason="AXES_INVALID", field="across")
    numbers = None if labels is None else labels_of(labels, len(points))
    axes = _axes(axes, across, title=f"Cloud, {len(points)} points")
    (a, b), (c,) = ("xyz".index(axis) for axis in across), set(range(3)) - {"xyz".index(x) for x in across}
    kept = np.flatnonzero(np.isfinite(points.points).all(axis=1))
    kept = kept[:: max(1, -(-len(kept) // MAX_POINTS))]
    at = points.points[kept]
    style: dict[str, Any] = {"s": 2, "linewidths": 0, "rasterized": True}
    if numbers is not None:
        chosen = numbers[kept]
        for number in np.unique(chosen):
            of = at[chosen == number]
            colour = "0.7" if number < 0 else f"C{number % 10}"
            # A legend of more is a wall of text.
            name = "none" if number < 0 else f"{number}" if number < 12 else None
            axes.scatter(of[:, a], of[:, b], color=colour, **style)
            axes.scatter([], [], color=colour, label=name)
    elif points.colours is not None:
        axes.scatter(at[:, a], at[:, b], c=points.colours[kept] / 255, **style)
    else:
        # What lies in front is drawn last.
        at = at[np.argsort(at[:, c], kind="stable")]
        drawn = axes.scatter(at[:, a], at[:, b], c=at[:, c], cmap="viridis", **style)
        if len(at):
            axes.figure.colorbar(drawn, ax=axes, label=f"{'xyz'[c]} [m]", shrink=0.8)
    return _finished(axes)


def _outline(axes: Any, box: OrientedBox, **style: Any) -> None:  # noqa: ANN401
    corners = np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0), (1, 1, 0)]) * box.size_m / 2
    axes.plot(*box.t_frame_box.apply(corners)[:, :2].T, **style)


def objects(things: Iterable[Object], *, axes: Any = None) -> Any:  # noqa: ANN401
    """Boxes of objects with their labels, a colour for each label."""
    axes = _axes(axes, title="Objects")
    colours: dict[str, str] = {}
    for thing in things:
        # The first colour is the trajectory's.
        colour = colours.setdefault(thing.label, f"C{1 + len(colours) % 9}")
        _outline(axes, thing.box, color=colour, label=thing.label, zorder=2)
        x, y = thing.box.centre[:2].tolist()
        name = f"{thing.label} {thing.object_id}"
        axes.text(x, y, name, ha="center", va="center", fontsize=8, zorder=5, **_haloed("black"))
    return _finished(axes)


def scene(graph: SceneGraph, *, axes: Any = None) -> Any:  # noqa: ANN401
    """A scene graph: rooms as outlines, objects as boxes, the robot as an arrow, and a line for each relation
    between two of them, but for `in_room`, which the drawing shows."""
    axes = _axes(axes, title="Scene graph")
    at: dict[str, Floats] = {node.node_id: node.t_map_node.translation[:2] for node in graph.nodes}
    for node in graph.nodes:
        if node.room is not None and len(node.room.outline):
            outline = np.vstack([node.room.outline, node.room.outline[:1]])
            axes.plot(*outline.T, color="0.6", label="room", zorder=1)
            axes.text(*node.room.center, node.label, color="0.4", ha="center", fontsize=9)
        if node.kind == SceneNodeKind.ROBOT:
            x, y = at[node.node_id]
            yaw = node.t_map_node.yaw_rad
            axes.scatter(x, y, color="tab:blue", label="robot", zorder=4)
            axes.annotate(
                "",
                xy=(x + 0.4 * math.cos(yaw), y + 0.4 * math.sin(yaw)),
                xytext=(x, y),
                arrowprops={"arrowstyle": "->", "color": "tab:blue", "lw": 2},
                zorder=4,
            )
    objects((node.object for node in graph.nodes if node.object is not None), axes=axes)
    kinds = sorted({str(r.kind) for r in graph.relations} - {"in_room"})
    styles = dict(zip(kinds, ("--", ":", "-.", "-") * len(kinds), strict=False))
    for relation in graph.relations:
        ends = [at[i] for i in (relation.subject_id, relation.object_id) if i in at]
        if str(relation.kind) in styles and len(ends) == 2:
            kind = str(relation.kind)
            axes.plot(*np.array(ends).T, color="0.35", linestyle=styles[kind], lw=1, label=kind, zorder=1)
    return _finished(axes)


def errors(pairs: PosePairs) -> tuple[Floats, Floats, Floats]:
    """Seconds since the first pose, translation errors (m) and rotation errors (deg), (N,) each."""
    seconds = (pairs.stamps_ns - pairs.stamps_ns[:1]) / 1e9
    translation = np.linalg.norm(pairs.estimate[:, :3] - pairs.reference[:, :3], axis=1)
    # Half the angle between two rotations has this cosine.
    cosine = np.abs(np.sum(pairs.estimate[:, 3:] * pairs.reference[:, 3:], axis=1))
    rotation = np.degrees(2 * np.arccos(np.clip(cosine, 0, 1)))
    return seconds, translation, rotation


def trajectories(metrics: TrajectoryMetrics | PosePairs) -> Any:  # noqa: ANN401
    """A matplotlib figure: both trajectories over each other, seen along the axis on which the truth moves
    least, and translation and rotation error over time. Metrics need to have been asked for with
    `return_pairs`."""
    pairs = metrics if isinstance(metrics, PosePairs) else metrics.pairs
    if pairs is None or len(pairs) == 0:
        raise ValueError("metrics hold no poses: ask for them with return_pairs=True")
    extent = np.ptp(pairs.reference[:, :3], axis=0)
    a, b = sorted(set(range(3)) - {int(np.argmin(extent))})
    figure = _figure("constrained", (11, 7))
    grid = figure.add_gridspec(2, 2)
    paths = _axes(figure.add_subplot(grid[:, 0]), "xyz"[a] + "xyz"[b])
    paths.plot(pairs.reference[:, a], pairs.reference[:, b], color="0.5", label="reference")
    paths.plot(pairs.estimate[:, a], pairs.estimate[:, b], color="tab:blue", label="estimate")
    paths.set(title="Trajectories")
    _finished(paths)
    seconds, translation, rotation = errors(pairs)
    for row, (values, label) in enumerate([(translation, "translation [m]"), (rotation, "rotation [deg]")]):
        axes = figure.add_subplot(grid[row, 1])
        axes.plot(seconds, values, color="tab:red")
        rmse = float(np.sqrt(np.mean(values**2)))
        axes.axhline(rmse, color="0.5", linestyle="--", label=f"rmse {rmse:.4g}")
        axes.set(xlabel="time [s]", ylabel=label, ylim=(0, None), title="Absolute error")
        axes.legend()
    return figure
