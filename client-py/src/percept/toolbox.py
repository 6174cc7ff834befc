"""The perception toolbox: one cloud or image in, facts out; no session. Absent parameters take the
server's defaults, which the contract names.

The calls stand in `_toolbox`, one file a group: kept clouds, files and pipelines; filters, sampling and
normals; neighbours, boxes and hulls; planes, clusters, shapes and objects; ground, smooth regions, convex
parts and pictures; registration; depth and colour images; features and several views of one scene.
"""

from __future__ import annotations

from ._toolbox.depth import AsyncDepth, Depth
from ._toolbox.depth_images import AsyncDepthImages, DepthImages
from ._toolbox.filters import AsyncFilters, Filters
from ._toolbox.images import AsyncImages, Images
from ._toolbox.kept import AsyncKept, Kept
from ._toolbox.regions import AsyncRegions, Regions
from ._toolbox.registration import AsyncRegistrationCalls, RegistrationCalls
from ._toolbox.segmentation import AsyncSegmentation, Segmentation
from ._toolbox.shapes import AsyncShapes, Shapes


class Toolbox(Kept, Filters, Shapes, Segmentation, Regions, RegistrationCalls, Depth, DepthImages, Images):
    """A cloud is a PointCloud, its points as (N, 3) float32 metres, or the handle of a kept one."""


class AsyncToolbox(
    AsyncKept,
    AsyncFilters,
    AsyncShapes,
    AsyncSegmentation,
    AsyncRegions,
    AsyncRegistrationCalls,
    AsyncDepth,
    AsyncDepthImages,
    AsyncImages,
):
    """A cloud is a PointCloud, its points as (N, 3) float32 metres, or the handle of a kept one."""
