"""Registration against the truth of the data sets, beside small_gicp and Open3D."""

from __future__ import annotations

import numpy as np

from . import data
from .finding import Finding, pose_error

METHODS = {"point_to_point": "ICP", "point_to_plane": "PLANE_ICP", "gicp": "GICP", "vgicp": "VGICP"}


def pairs():
    """Name, source, target, truth, and how exact the truth is: metres, degrees."""
    yield ("small_gicp", *data.lidar_pair(), 0.05, 1.0)
    yield ("kitti 94-95", *data.kitti_pair(), 0.05, 0.2)


def local(toolbox):
    """From identity, with clouds thinned to 25 cm, beside small_gicp with the same parameters.

    Where both stop at different places, as tangent planes on the rings of a lidar may (several minima), plain
    ICP in numpy on the same points has to stay at our answer.
    """
    for name, source, target, truth, metres, degrees in pairs():
        for method, theirs in METHODS.items():
            found = toolbox.register_clouds(
                source,
                target=target,
                method=method,
                voxel_sizes_m=[0.25],
                max_distance_m=1.0,
                max_iterations=100,
                num_neighbours=10,
            )
            off_m, off_deg = pose_error(found.t_target_source.matrix, truth)
            figures = {"off_m": off_m, "off_deg": off_deg, "iterations": found.iterations}
            peer = small_gicp(source, target, theirs)
            if peer is not None:
                figures["reference_off_m"], figures["reference_off_deg"] = pose_error(peer, truth)
                figures["to_reference_m"], figures["to_reference_deg"] = pose_error(found.t_target_source.matrix, peer)
            right = off_m < metres and off_deg < degrees
            if method in ("point_to_point", "point_to_plane"):
                thinned = [toolbox.downsample_voxels(c, voxel_size_m=0.25).points for c in (source, target)]
                stays = plain_icp(*thinned, found.t_target_source.matrix, planes=method == "point_to_plane")
                moved_m, moved_deg = pose_error(stays, found.t_target_source.matrix)
                figures |= {"numpy_moves_m": moved_m, "numpy_moves_deg": moved_deg}
                right &= moved_m < 0.005 and moved_deg < 0.02
            yield Finding(f"register_clouds {method}", name, "truth; small_gicp", right, figures)


def small_gicp(source, target, kind):
    try:
        import small_gicp
    except ImportError:
        return None
    found = small_gicp.align(
        target.astype(float),
        source.astype(float),
        registration_type=kind,
        voxel_resolution=1.0,
        downsampling_resolution=0.25,
        max_correspondence_distance=1.0,
        max_iterations=100,
        rotation_epsilon=1e-5,
        translation_epsilon=1e-5,
    )
    return found.T_target_source


def plain_icp(source, target, start, *, planes):
    """Ten steps of Gauss and Newton on pairs nearer than 1 m; planes of the 10 nearest."""
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    source, target, pose = source.astype(float), target.astype(float), start.copy()
    tree = cKDTree(target)
    if planes:
        around = target[tree.query(target, 10)[1]]
        around -= around.mean(1, keepdims=True)
        normals = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0]
    for _ in range(10):
        moved = source @ pose[:3, :3].T + pose[:3, 3]
        away, nearest = tree.query(moved)
        p, q = moved[away < 1.0], target[nearest[away < 1.0]]
        if planes:
            n = normals[nearest[away < 1.0]]
            jacobian, residual = np.hstack([np.cross(p, n), n]), ((p - q) * n).sum(1)
        else:
            axes = [np.hstack([np.cross(p, a), np.broadcast_to(a, p.shape)]) for a in np.eye(3)]
            jacobian, residual = np.vstack(axes), (p - q).T.ravel()
        step = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        change = np.eye(4)
        change[:3, :3], change[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
        pose = change @ pose
    return pose


def colored(toolbox):
    """Two frames of Redwood against Open3D's coloured ICP, from identity, and their trajectory."""
    import open3d as o3d
    from percept import CameraIntrinsics

    from .points import legacy

    camera = CameraIntrinsics(width_px=640, height_px=480, fx_px=525, fy_px=525, cx_px=319.5, cy_px=239.5)
    clouds = []
    for i in (0, 1):
        cloud = toolbox.unproject_depth(
            data.depth(i), intrinsics=camera, metres_per_unit=0.001, colour=data.color(i), max_depth_m=4.0
        )
        clouds.append(toolbox.downsample_voxels(cloud, voxel_size_m=0.02))
    truth = redwood_pose(0, 1)
    found = toolbox.register_clouds(clouds[1], target=clouds[0], method="coloured", max_distance_m=0.06)
    theirs = []
    for cloud in clouds:
        theirs.append(legacy(cloud.points))
        theirs[-1].colors = o3d.utility.Vector3dVector(cloud.colors / 255.0)
        theirs[-1].estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.06, 30))
    peer = o3d.pipelines.registration.registration_colored_icp(theirs[1], theirs[0], 0.06)
    off_m, off_deg = pose_error(found.t_target_source.matrix, truth)
    peer_m, peer_deg = pose_error(peer.transformation, truth)
    figures = {"off_m": off_m, "off_deg": off_deg, "reference_off_m": peer_m, "reference_off_deg": peer_deg}
    right = off_m < max(0.02, 1.2 * peer_m) and off_deg < max(0.5, 1.2 * peer_deg)
    yield Finding("register_clouds coloured", "redwood 0-1", "trajectory; Open3D", right, figures)


def redwood_pose(a, b):
    """t_a_b of two frames of the trajectory."""
    lines = (data.folder("rgbd-open3d-redwood") / "trajectory.log").read_text().splitlines()
    rows = [[float(x) for x in line.split()] for line in lines if line.strip()]
    poses = [np.array(rows[i + 1 : i + 5]) for i in range(0, len(rows), 5)]
    return np.linalg.inv(poses[a]) @ poses[b]


def anywhere(toolbox):
    """With no guess: the pairs turned by a random rotation first."""
    rng = np.random.default_rng(7)
    for name, source, target, truth, metres, degrees in pairs():
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        start = np.eye(4)
        start[:3, :3] = turn * np.sign(np.linalg.det(turn))
        start[:3, 3] = rng.uniform(-20, 20, 3)
        moved = (source.astype(float) @ start[:3, :3].T + start[:3, 3]).astype(np.float32)
        found = toolbox.register_clouds_globally(moved, target=target, voxel_size_m=0.5)
        off_m, off_deg = pose_error(found.t_target_source.matrix @ start, truth)
        figures = {"off_m": off_m, "off_deg": off_deg, "overlap": found.overlap}
        right = found.outcome == "found" and off_m < 2 * metres and off_deg < 2 * degrees
        yield Finding("register_clouds_globally", name, "truth", right, figures)


CHECKS = [local, colored, anywhere]
