"""Depth and colour images: numpy, OpenCV and Open3D."""

from __future__ import annotations

import numpy as np
from percept import CameraIntrinsics

from . import data
from .finding import Finding, angles_deg

PINHOLE = {"width_px": 640, "height_px": 480, "fx_px": 525.0, "fy_px": 525.0, "cx_px": 319.5, "cy_px": 239.5}
K = np.array([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]])
#: As calibrations of such cameras have them.
LENSES = {
    "plumb_bob": (0.16, -0.31, 0.0008, -0.0004, 0.11),
    "rational": (0.4, -0.2, 0.0005, -0.0003, 0.02, 0.5, -0.1, 0.01),
    "fisheye": (-0.02, 0.004, -0.003, 0.0007),
}


def depth_to_cloud(toolbox):
    """Without distortion against Open3D, with the models of distortion against OpenCV's rays."""
    import cv2
    import open3d as o3d

    depth = data.depth()
    camera = CameraIntrinsics(**PINHOLE)
    found = toolbox.unproject_depth(depth, intrinsics=camera, metres_per_unit=0.001, max_depth_m=60.0).points
    theirs = o3d.geometry.PointCloud.create_from_depth_image(
        o3d.geometry.Image(depth),
        o3d.camera.PinholeCameraIntrinsic(640, 480, 525, 525, 319.5, 239.5),
        depth_scale=1000.0,
        depth_trunc=100.0,
    )
    yield depth_finding("none", "Open3D", found, np.asarray(theirs.points))
    v, u = np.nonzero(depth)
    z = depth[v, u] / 1000.0
    pixels = np.stack([u, v], 1).astype(float).reshape(-1, 1, 2)
    tight = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    for model, coefficients in LENSES.items():
        camera = CameraIntrinsics(**PINHOLE, distortion_model=model, distortion=coefficients)
        found = toolbox.unproject_depth(depth, intrinsics=camera, metres_per_unit=0.001, max_depth_m=60.0).points
        d = np.array(coefficients)
        if model == "fisheye":
            rays = cv2.fisheye.undistortPoints(pixels, K, d, criteria=tight)
        else:
            rays = cv2.undistortPoints(pixels, K, d, criteria=tight)
        expected = np.column_stack([rays.reshape(-1, 2) * z[:, None], z])
        yield depth_finding(model, "OpenCV", found, expected)


def depth_finding(model, reference, found, expected):
    figures = {"points": len(found), "expected": len(expected)}
    same = len(found) == len(expected)
    if same:
        figures["max_off_m"] = float(np.abs(found - expected).max())
    right = same and figures["max_off_m"] < 2e-5
    return Finding(f"unproject_depth {model}", "redwood", reference, right, figures)


def codecs(toolbox):
    """PNG, JPEG and clouds' files as OpenCV and Open3D read them."""
    import cv2

    root = data.folder("rgbd-open3d-redwood")
    png, jpeg = (root / "depth/00000.png").read_bytes(), (root / "color/00000.jpg").read_bytes()
    off = np.abs(toolbox.decode_depth(png, metres_per_unit=0.001) - data.depth() / 1000.0).max()
    yield Finding("decode_depth", "redwood", "OpenCV", bool(off < 1e-6), {"max_off_m": float(off)})
    off = np.abs(toolbox.decode_colour(jpeg).astype(int) - data.color()).max()
    # Decoders round the transform and the chroma differently.
    yield Finding("decode_color jpeg", "redwood", "OpenCV", bool(off <= 4), {"max_off": int(off)})
    ours = toolbox.encode_colour(data.color())
    same = np.array_equal(cv2.imdecode(np.frombuffer(ours, np.uint8), 1)[..., ::-1], data.color())
    yield Finding("encode_color png", "redwood", "OpenCV", same, {})
    for path in sorted(data.folder("cloud-pcl").glob("*.pcd")):
        found = toolbox.decode_cloud(path.read_bytes()).cloud.points
        found, expected = found[np.isfinite(found).all(1)], data.pcd(path)
        same = found.shape == expected.shape and np.array_equal(found, expected)
        yield Finding("decode_cloud", path.name, "Open3D", same, {"points": len(found)})


def filters(toolbox):
    """Median and bilateral filters against OpenCV's where no hole is near, which OpenCV does not know."""
    import cv2

    depth = (data.depth() / 1000.0).astype(np.float32)
    hole = cv2.dilate((depth == 0).astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    hole[:8], hole[-8:], hole[:, :8], hole[:, -8:] = True, True, True, True
    found = toolbox.filter_depth(depth, [("median", {"size_px": 5})])
    off = np.abs(found - cv2.medianBlur(depth, 5))[~hole]
    figures = {"pixels": int((~hole).sum()), "max_off_m": float(off.max())}
    yield Finding("filter_depth median", "redwood", "OpenCV", bool(off.max() < 1e-6), figures)
    params = {"radius_px": 2, "sigma_px": 5.0, "sigma_depth_m": 0.03}
    found = toolbox.filter_depth(depth, [("bilateral", params)])
    off = np.abs(found - cv2.bilateralFilter(depth, 5, 0.03, 5.0))[~hole]
    figures = {
        "pixels": int((~hole).sum()),
        "median_off_m": float(np.median(off)),
        "max_off_m": float(off.max()),
    }
    yield Finding("filter_depth bilateral", "redwood", "OpenCV", bool(off.max() < 1e-4), figures)


def normals(toolbox):
    """Against the cross product in numpy, and of a smoothed image against Open3D's normals of its cloud."""
    import open3d as o3d

    from .points import legacy

    camera = CameraIntrinsics(**PINHOLE)
    depth = (data.depth() / 1000.0).astype(np.float32)
    xyz = vertices(depth)
    found = toolbox.compute_depth_normals(depth, intrinsics=camera, step_px=2)[2:-2, 2:-2]
    middle, z = xyz[2:-2, 2:-2], depth[2:-2, 2:-2]
    around = [xyz[2:-2, 4:], xyz[2:-2, :-4], xyz[4:, 2:-2], xyz[:-4, 2:-2]]
    # Where all four neighbours are on the pixel's surface.
    even = z > 0
    for neighbour in around:
        even &= (neighbour[..., 2] > 0) & (np.abs(neighbour[..., 2] - z) < 0.01 * z)
    expected = np.cross(around[2] - around[3], around[0] - around[1])
    slanted = np.abs((expected * middle).sum(-1)) < 0.2 * np.linalg.norm(expected, axis=-1) * z
    even &= ~slanted
    off = angles_deg(found[even], expected[even] / np.linalg.norm(expected[even], axis=1, keepdims=True))
    figures = {"pixels": int(even.sum()), "median_deg": float(np.median(off)), "max_deg": float(off.max())}
    yield Finding("compute_depth_normals", "redwood", "numpy", figures["max_deg"] < 0.1, figures)
    smooth = toolbox.filter_depth(depth, [("bilateral", {"radius_px": 6, "sigma_px": 4.0})])
    found = toolbox.compute_depth_normals(smooth, intrinsics=camera, step_px=6)[smooth > 0]
    cloud = legacy(vertices(smooth)[smooth > 0])
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.05, 200))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    defined = found.any(1)
    off = angles_deg(found, np.asarray(cloud.normals))[defined]
    figures = {"defined_share": float(defined.mean()), "median_deg": float(np.median(off))}
    # Other neighbours: a cross of four against a disc; noise and edges count otherwise.
    right = figures["median_deg"] < 5
    yield Finding("compute_depth_normals", "redwood, smooth", "Open3D, of the cloud", right, figures)


def vertices(depth):
    """(H, W, 3) float64, metres."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    z = depth.astype(float)
    return np.stack([(u - 319.5) * z / 525, (v - 239.5) * z / 525, z], -1)


def depth_planes(toolbox):
    """The largest connected planes against least squares on their own pixels."""
    camera = CameraIntrinsics(**PINHOLE)
    depth = (data.depth() / 1000.0).astype(np.float32)
    found = toolbox.segment_depth_planes(depth, intrinsics=camera)
    xyz = vertices(depth)
    for number, one in enumerate(found.planes[:3]):
        points = xyz[found.labels == number]
        center, (values, vectors) = points.mean(0), np.linalg.eigh(np.cov(points.T))
        plane = one.plane
        figures = {
            "pixels": len(points),
            "off_m": float(abs(plane.normal @ center + plane.offset_m)),
            "off_deg": float(angles_deg(plane.normal[None], vectors[:, :1].T, signed=False)[0]),
            "rms_m": float(np.sqrt(values[0])),
        }
        right = figures["off_m"] < 0.002 and figures["off_deg"] < 0.2 and len(points) == one.num_pixels
        yield Finding(f"segment_depth_planes {number + 1}", "redwood", "numpy", right, figures)


def color_to_depth(toolbox):
    """Colours of a camera 5 cm beside, against the formula in numpy with a map of nearest depths."""
    camera = CameraIntrinsics(**PINHOLE)
    depth, color = data.depth() / 1000.0, data.color()
    t_color_depth = np.eye(4)
    t_color_depth[0, 3] = -0.05
    found, seen = toolbox.register_colour(
        depth.astype(np.float32),
        color,
        depth_camera=camera,
        colour_camera=camera,
        t_colour_depth=t_color_depth,
    )
    v, u = np.nonzero(depth)
    z = depth[v, u]
    column = ((u - 319.5) * z / 525 - 0.05) / z * 525 + 319.5
    inside = seen[v, u] & (column >= 0) & (column <= 638)
    left = np.floor(column[inside]).astype(int)
    share = (column[inside] - left)[:, None]
    row = v[inside]
    between = color[row, left] * (1 - share) + color[row, left + 1] * share
    nearest = color[row, np.rint(column[inside]).astype(int)]
    ours = found[v, u][inside].astype(float)
    off = np.minimum(np.abs(ours - between).max(1), np.abs(ours - nearest).max(1))
    figures = {"seen_share": float(seen[v, u].mean()), "p99_off": float(np.quantile(off, 0.99))}
    yield Finding("register_color", "redwood", "numpy", figures["p99_off"] <= 1.0, figures)


CHECKS = [codecs, depth_to_cloud, filters, normals, depth_planes, color_to_depth]
