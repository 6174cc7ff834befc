# %% [markdown]
# # From points to a plan
#
# A lesson in perception, end to end: load a cloud, clean it, find planes and clusters, describe them, register two
# views, map a room, detect what stands in it, relate it, and plan a way. It needs a running server
# (`percept serve`) and nothing else: what the robot sees is computed by `room.py`. Metres, radians, z up.

# %%
import builtins
import pathlib
import tempfile

import numpy as np
import percept.plot
from percept import Client, Pose, RelationFilter

import room

# In a notebook pictures and tables are shown; a terminal has the printed lines.
show = getattr(builtins, "display", lambda value: None)
client = Client(room.SERVER)
toolbox = client.toolbox

# %% [markdown]
# ## Load
#
# A sweep of a lidar, moved from the sensor to the floor's frame by the mount, written to a file and read again. A
# cloud is an array (N, 3) with optional channels: colours, intensities, normals.

# %%
here = room.drive(1)[0]
points = (here @ room.LIDAR.t_base_sensor).apply(room.sweep(here, rings=96)).astype(np.float32)
rng = np.random.default_rng(1)
noisy = points + rng.normal(0, 0.005, points.shape).astype(np.float32)
stray = rng.uniform([-3, -2, 0], [3, 2, 2.5], (200, 3)).astype(np.float32)
with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder) / "room.ply"
    toolbox.write_cloud(np.vstack([noisy, stray]), path)
    cloud = toolbox.read_cloud(path)
print(len(cloud), "points, 200 of them in the air")

# %% [markdown]
# ## Clean
#
# A point whose neighbours are much farther away than is usual in this cloud is noise. Then one point a voxel is
# enough: near the sensor there are thousands on a hand's breadth.

# %%
clean = toolbox.remove_statistical_outliers(cloud).cloud
thin = toolbox.downsample_voxels(clean, voxel_size_m=0.04)
print(len(cloud), "->", len(clean), "->", len(thin), "points")
show(thin)

# %% [markdown]
# ## Planes
#
# Floor, walls and ceiling are planes: n . p + d = 0. RANSAC draws three points, counts who lies on their plane, and
# keeps the best; what is left are the things, less what lies in a plane with something larger: a shelf's front.

# %%
planes = toolbox.segment_planes(thin, distance_m=0.03, max_planes=6, min_points=500)
for plane in planes:
    print(plane.kind, len(plane.indices), "points, normal", np.round(plane.plane.normal, 2))
on_planes = np.zeros(len(thin), bool)
for plane in planes:
    on_planes[plane.indices] = True
things = thin[~on_planes]

# %% [markdown]
# ## Clusters, and their features
#
# Points that are near each other belong together. The eigenvalues of a cluster's covariance tell whether it is a
# line, a sheet, or as thick as it is wide.

# %%
clusters = toolbox.cluster_points(things, eps_m=0.12, min_points=30)
print(clusters.num_clusters, "clusters")
for label in range(clusters.num_clusters):
    shape = toolbox.compute_shape_features(things.select(clusters, label=label))
    size, kind = np.round(shape.upright_box.size_m, 2), shape.features
    print(f"{label}: {size} m, linear {kind.linearity:.2f}, planar {kind.planarity:.2f}")
show(percept.plot.cloud(things, labels=clusters).figure)

# %% [markdown]
# ## Register
#
# The same room from another place. FPFH describes the surface about each point, so that places that look alike are
# found with no guess. Believe the answer only if it is `found`: a room with four walls looks much the same when it is
# turned round, and then the answer is `ambiguous`. Wheels tell about where the robot went, and ICP makes that exact.

# %%
there = Pose.from_xy_yaw(0.4, 0.3, 0.8)
# What each sweep saw, in the frame of its own base.
a, b = (room.LIDAR.t_base_sensor.apply(room.sweep(p, rings=96)).astype(np.float32) for p in (here, there))
features = toolbox.compute_point_features(toolbox.downsample_voxels(b, voxel_size_m=0.1))
print("features", features.shape)
coarse = toolbox.register_clouds_globally(b, target=a, voxel_size_m=0.1)
print("with no guess:", coarse.outcome)
truth = here.inverse() @ there
# 8 cm and 3 degrees beside the truth, as wheels are.
wheels = truth @ Pose.from_xy_yaw(0.07, -0.04, np.radians(3.0))
guess = coarse.t_target_source if coarse.outcome == "found" else wheels
fine = toolbox.register_clouds(b, target=a, initial_guess=guess, max_distance_m=0.2, max_iterations=50)
off = fine.t_target_source.inverse() @ truth
error_mm, error_deg = 1000 * np.linalg.norm(off.translation), np.degrees(abs(off.yaw_rad))
print(f"icp: {fine.outcome}, {error_mm:.0f} mm and {error_deg:.2f} degrees off")

# %% [markdown]
# ## Map
#
# A session does that with every frame, and keeps what it has seen: poses, a cloud, and a grid of what is free.

# %%
session = client.sessions.create(sensors=[room.LIDAR])
drive = room.drive(90)[::3]
with session.stream() as stream:
    for i, pose in enumerate(drive):
        stream.send_cloud("lidar", stamp_ns=room.stamp(i), points=room.sweep(pose))
way = session.trajectory()
end = (drive[0].inverse() @ drive[-1]).translation
print(f"{way.length_m:.2f} m of way, {1000 * np.linalg.norm(way.positions[-1] - end):.0f} mm off at its end")
show(session.pose())
grid = session.map.occupancy()
show(grid)

# %% [markdown]
# ## Detect
#
# What stands on the floor is told apart by its shape, with a probability, and keeps its number while it is seen.

# %%
objects = session.scene.objects().all()
for thing in objects:
    print(f"{thing.label} {thing.object_id}: {thing.confidence:.2f} at {np.round(thing.box.centre, 1)}")
show(objects)

# %% [markdown]
# ## Relate
#
# Left of what, near what, in which room: a scene graph, seen from where the robot stands.

# %%
near = RelationFilter(kinds=["near", "left_of", "in_front_of"], min_strength=0.5)
graph = session.scene.graph(directions="robot", relations=near)
for relation in graph.relations:
    print(relation, f"({relation.strength:.2f})")
show(graph)

# %% [markdown]
# ## Plan
#
# A way to beside a thing, clear of all others. No path would be an answer, too, with its reason.

# %%
target = max(objects, key=lambda thing: thing.box.size_m[2])
plan = session.plan_to(target)
print(f"to {target.label} {target.object_id}:", f"{plan.length_m:.2f} m" if plan else plan.reason)
axes = percept.plot.occupancy(grid)
percept.plot.trajectory(way, axes=axes)
percept.plot.objects(objects, axes=axes)
show(percept.plot.path(plan, axes=axes).figure)

# %%
session.delete()
client.close()
