"""How results show themselves in notebooks, and what they become for other packages."""

import dataclasses
import html.parser
import importlib
import subprocess
import sys

import numpy as np
import pytest

import percept.plot
from percept import (
    Clusters,
    Heights,
    Listing,
    MapStamp,
    Mesh,
    NoPath,
    Object,
    ObjectAnnotation,
    OccupancyGrid,
    OrientedBox,
    Path,
    PointCloud,
    Pose,
    PosePairs,
    SceneGraph,
    Trajectory,
)

STAMP = MapStamp(map_version=3, stamp_ns=5, frame_id="map")
GRID = OccupancyGrid(
    cells=np.array([[0, 100, -1], [50, 0, 0]], np.int8),
    resolution_m=0.5,
    origin=np.array([1.0, -2.0]),
    stamp=STAMP,
)
NO_GRID = OccupancyGrid(cells=np.zeros((0, 0), np.int8), resolution_m=0.5, origin=np.zeros(2), stamp=STAMP)
CLOUD = PointCloud(
    np.array([[0, 0, 0], [1, 0, 0.5], [2, 1, 1], [np.nan, 0, 0]], np.float32),
    colours=np.full((4, 3), 51, np.uint8),
)
WAY = Trajectory(
    stamps_ns=np.array([1, 2, 3]),
    positions=np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]]),
    rotations=np.tile([0.0, 0, 0, 1], (3, 1)),
    states=("tracking", "lost", "tracking"),
    keyframe_ids=(0, None, 1),
    scales=("metric",) * 3,
    map_version=3,
)
PATH = Path(
    waypoints=np.array([[0.0, 0], [3, 0], [3, 4]]),
    yaws_rad=np.array([0.0, 0, np.pi / 2]),
    length_m=7.0,
    cost=7.0,
    min_clearance_m=0.5,
    clearances_m=np.full(3, 0.5),
    times_s=np.arange(3.0),
    is_reverse=np.array([False, True, False]),
    clearance_cost=0.0,
    steering_cost=0.0,
    duration_s=2.0,
    bound=None,
    is_final=True,
    stamp=STAMP,
)


def thing(number, label="table"):
    return Object(
        object_id=number,
        label=label,
        object_class="table",
        confidence=0.9,
        box=OrientedBox(t_frame_box=Pose.from_xyz(1, 2, 0.4, yaw_rad=0.5), size_m=(1, 0.5, 0.8)),
        state="static",
        velocity_mps=np.zeros(3),
        velocity_variance=0.0,
        first_seen_ns=1,
        last_seen_ns=2,
        num_observations=3,
        class_probabilities={"table": 0.9},
        annotation=ObjectAnnotation(label="", is_deleted=False, part_of=None, is_drawn=False),
        history=(),
    )


class Cells(html.parser.HTMLParser):
    """The rows of the tables of a page."""

    def __init__(self, page):
        super().__init__()
        self.rows = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag == "tr":
            self.rows.append([])

    def handle_data(self, data):
        if self.rows:
            self.rows[-1].append(data)


def test_a_list_of_objects_is_a_table():
    names, first, second = Cells(Listing([thing(7), thing(8, "<b>&")])._repr_html_()).rows
    row = dict(zip(names, first, strict=True))
    assert (row["object_id"], row["label"], row["box_x_m"], row["box_size_z_m"]) == ("7", "table", "1", "0.8")
    assert "<b>&" in second
    assert Listing([])._repr_html_() == "<p>none</p>"


def test_a_pose_is_a_table_with_its_angles():
    names, values = Cells(
        Pose.from_xyz(1, 2, 3, roll_rad=0.1, pitch_rad=-0.2, yaw_rad=3.0)._repr_html_()
    ).rows
    assert dict(zip(names, values, strict=True)) == {
        "x_m": "1",
        "y_m": "2",
        "z_m": "3",
        "roll_rad": "0.1",
        "pitch_rad": "-0.2",
        "yaw_rad": "3",
    }


def in_metres(axes):
    """The plain facts of a drawing: labels in metres, one scale bar that is as long as it says."""
    assert axes.get_xlabel().endswith("[m]")
    assert axes.get_ylabel().endswith("[m]")
    marks = [artist for artist in axes.texts if artist.get_gid() == "scale"]
    (text,) = (mark for mark in marks if mark.get_text())
    (bar,) = (mark for mark in marks if not mark.get_text())
    low, high = axes.get_xlim()
    length = (bar.xyann[0] - bar.xy[0]) * (high - low)
    assert float(text.get_text().removesuffix(" m")) == pytest.approx(length)
    return {text.get_text() for text in axes.get_legend().get_texts()} if axes.get_legend() else set()


def test_what_a_session_has_mapped_is_one_drawing():
    pytest.importorskip("matplotlib")
    axes = percept.plot.session("hall", GRID, WAY, [thing(7)])
    assert {"free", "trajectory", "table"} <= in_metres(axes)
    assert axes.get_title() == "hall, 7.0 m"
    nothing = dataclasses.replace(WAY, positions=np.zeros((0, 3)), states=())
    axes = percept.plot.session("hall", NO_GRID, nothing, [])
    assert "empty" in [text.get_text() for text in axes.texts]


def test_plots_are_there_with_the_package():
    # The documentation says percept.plot.occupancy(...) after `import percept`.
    there = "import percept, sys; percept.plot.occupancy; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", there], check=True)


def test_zenoh_says_what_to_install(monkeypatch):
    # The module is called zenoh, the package is not.
    monkeypatch.setitem(sys.modules, "zenoh", None)
    monkeypatch.delitem(sys.modules, "percept.zenoh", raising=False)
    with pytest.raises(ImportError, match=r"needs eclipse-zenoh, .*: pip install 'percept\[zenoh\]'"):
        importlib.import_module("percept.zenoh")


def test_what_is_drawn_over_a_map_keeps_its_metres():
    pytest.importorskip("matplotlib")
    axes = percept.plot.occupancy(GRID)
    assert in_metres(axes) == {"free", "occupied", "unknown"}
    assert axes.images[0].get_extent() == [1.0, 2.5, -2.0, -1.0]
    percept.plot.trajectory(WAY, axes=axes)
    percept.plot.path(PATH, axes=axes)
    percept.plot.objects([thing(7)], axes=axes)
    assert {"free", "trajectory", "lost", "path", "backwards", "start", "goal", "table"} <= in_metres(axes)
    (path,) = (line for line in axes.lines if line.get_label() == "path")
    assert np.array_equal(path.get_xydata(), PATH.waypoints)
    box = next(line for line in axes.lines if line.get_label() == "table").get_xydata()
    corner = Pose.from_xy_yaw(1, 2, 0.5).apply(np.array([0.5, 0.25, 0.0]))
    assert np.allclose(box[0], corner[:2])
    none = NoPath(reason="unreachable", detail="walls", blocking=None, stamp=STAMP)
    assert percept.plot.path(none).get_title() == "no path: walls"


def test_a_cloud_is_drawn_by_labels_from_the_side_that_is_asked_for():
    pytest.importorskip("matplotlib")
    clusters = Clusters(labels=np.array([0, -1, 1, 0], np.int32), num_clusters=2)
    axes = percept.plot.cloud(CLOUD, labels=clusters, across="xz")
    assert in_metres(axes) == {"none", "0", "1"}
    drawn = np.vstack([c.get_offsets() for c in axes.collections])
    finite = CLOUD.points[:3, [0, 2]]
    assert sorted(map(tuple, drawn.tolist())) == sorted(map(tuple, finite.tolist()))
    for wrong in ("xx", "x", "xyz", "ab"):
        with pytest.raises(TypeError, match="across"):
            percept.plot.cloud(CLOUD, across=wrong)
    with pytest.raises(ValueError, match="labels"):
        percept.plot.cloud(CLOUD, labels=np.zeros(3, np.int32))


def test_a_straight_drive_is_drawn_on_a_plane():
    pytest.importorskip("matplotlib")
    ahead = dataclasses.replace(WAY, positions=np.array([[0.0, 0, 0], [5, 0, 0], [10, 0, 0]]))
    axes = percept.plot.trajectory(ahead)
    low, high = axes.get_ylim()
    assert high - low >= 3.0
    in_metres(axes)
    aside = dataclasses.replace(WAY, positions=np.array([[0.0, 0, 0], [0, 50, 0], [0, 90, 0]]))
    assert percept.plot.trajectory(aside, axes=axes).get_ylim()[1] > 90


def test_the_figure_of_an_evaluation_has_room_for_all_its_axes(recwarn):
    pytest.importorskip("matplotlib")
    angle = np.linspace(0, 6, 50)
    way = np.column_stack([3 * np.cos(angle), 2 * np.sin(angle), np.zeros((50, 4)), np.ones(50)])
    pairs = PosePairs(stamps_ns=np.arange(50), reference=way, estimate=way)
    figure = percept.plot.trajectories(pairs)
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert not recwarn.list
    assert all(min(axes.get_position().size) > 0.1 for axes in figure.axes)


NOTHING = PointCloud(np.zeros((0, 3), np.float32))
NOWHERE = PointCloud(np.full((5, 3), np.nan, np.float32))
NO_SCENE = SceneGraph(stamp_ns=0, map_version=0, frame_id="map", nodes=(), relations=())


@pytest.mark.parametrize("shown", [GRID, NO_GRID, CLOUD, NOTHING, NOWHERE, WAY, PATH])
def test_what_people_look_at_is_a_picture_in_a_notebook_also_if_it_is_empty(shown):
    pytest.importorskip("matplotlib")
    assert shown._repr_png_().startswith(b"\x89PNG")


def test_without_matplotlib_it_shows_as_text_and_plot_says_what_to_install(monkeypatch):
    pytest.importorskip("matplotlib")
    assert "<img" in NO_SCENE._repr_html_()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.colors", None)
    assert GRID._repr_png_() is None
    assert "<img" not in NO_SCENE._repr_html_()
    with pytest.raises(ImportError, match=r"pip install 'percept\[plot\]'"):
        percept.plot.cloud(CLOUD)


@pytest.mark.parametrize(
    ("module", "convert"),
    [
        ("open3d", CLOUD.to_open3d),
        ("pandas", CLOUD.to_pandas),
        ("pandas", WAY.to_pandas),
        ("pandas", PATH.to_pandas),
        ("pandas", Listing([thing(7)]).to_pandas),
        ("xarray", GRID.to_xarray),
        ("PIL.Image", GRID.to_pil),
    ],
)
def test_what_is_not_installed_is_named(monkeypatch, module, convert):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match="pip install"):
        convert()


def test_frames_of_pandas_hold_what_was_told():
    pandas = pytest.importorskip("pandas")
    objects = Listing([thing(7), thing(8)]).to_pandas()
    assert objects["object_id"].tolist() == [7, 8]
    assert objects["box_yaw_rad"].tolist() == pytest.approx([0.5, 0.5])
    way = WAY.to_pandas()
    assert way[["x_m", "y_m"]].to_numpy().tolist() == [[0, 0], [3, 0], [3, 4]]
    assert pandas.isna(way["keyframe_id"][1])
    assert PATH.to_pandas()["is_reverse"].tolist() == [False, True, False]
    assert CLOUD.to_pandas().columns.tolist() == ["x_m", "y_m", "z_m", "red", "green", "blue"]
    assert len(Listing([]).to_pandas()) == 0


def test_grids_of_xarray_are_found_by_metres():
    pytest.importorskip("xarray")
    cells = GRID.to_xarray()
    for x in (1.1, 1.6, 2.4):
        for y in (-1.9, -1.1):
            assert int(cells.sel(x=x, y=y, method="nearest")) == GRID.cell_at(x, y)
    layers = {
        name: np.zeros((2, 3), np.float32)
        for name in ("ground_m", "sigma_m", "top_m", "slope_rad", "step_m", "roughness_m", "traversability")
    }
    heights = Heights(
        **layers, is_drop=np.zeros((2, 3), bool), resolution_m=0.5, origin=np.array([1.0, -2.0]), stamp=STAMP
    )
    assert set(heights.to_xarray().data_vars) == {*layers, "is_drop"}


def test_an_image_of_pillow_has_its_first_row_at_the_largest_y():
    pytest.importorskip("PIL.Image")
    assert np.allclose(np.asarray(GRID.to_pil()), [[127.5, 255, 255], [255, 0, 205]], atol=0.5)


def test_clouds_and_meshes_of_open3d():
    pytest.importorskip("open3d")
    cloud = CLOUD[:3].to_open3d()
    assert np.array_equal(np.asarray(cloud.points), CLOUD.points[:3])
    assert np.allclose(np.asarray(cloud.colors), 0.2)
    assert not cloud.has_normals()
    corners = np.eye(3, dtype=np.float32)
    mesh = Mesh(
        positions=corners,
        normals=corners,
        colours=np.zeros((3, 3), np.uint8),
        triangles=np.array([[0, 1, 2]], np.uint32),
        stamp=STAMP,
    ).to_open3d()
    assert np.asarray(mesh.triangles).tolist() == [[0, 1, 2]]
    assert mesh.has_vertex_normals()
