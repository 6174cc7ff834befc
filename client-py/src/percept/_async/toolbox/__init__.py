"""The perception toolbox: one cloud or image in, facts out; no session. Absent parameters take the
server's defaults, which the contract names.

One file a group: kept clouds, files and pipelines; filters, sampling and
normals; neighbours, boxes and hulls; planes, clusters, shapes and objects; ground, smooth regions, convex
parts and pictures; registration; depth and colour images; features and several views of one scene; paths
on maps that come along.
"""

from __future__ import annotations

from .depth import AsyncDepth
from .depth_images import AsyncDepthImages
from .filters import AsyncFilters
from .images import AsyncImages
from .kept import AsyncKept
from .planning import AsyncPlanning
from .regions import AsyncRegions
from .registration import AsyncRegistrationCalls
from .segmentation import AsyncSegmentation
from .shapes import AsyncShapes


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
    AsyncPlanning,
):
    """A cloud is a PointCloud, its points as (N, 3) float32 metres, or the handle of a kept one."""
