# Written by client-py/generate from _async/toolbox/__init__.py; change that.
"""The perception toolbox: one cloud or image in, facts out; no session. Absent parameters take the
server's defaults, which the contract names.

One file a group: kept clouds, files and pipelines; filters, sampling and
normals; neighbours, boxes and hulls; planes, clusters, shapes and objects; ground, smooth regions, convex
parts and pictures; registration; depth and colour images; features and several views of one scene; paths
on maps that come along.
"""

from __future__ import annotations

from .depth import Depth
from .depth_images import DepthImages
from .filters import Filters
from .images import Images
from .kept import Kept
from .planning import Planning
from .regions import Regions
from .registration import RegistrationCalls
from .segmentation import Segmentation
from .shapes import Shapes


class Toolbox(
    Kept,
    Filters,
    Shapes,
    Segmentation,
    Regions,
    RegistrationCalls,
    Depth,
    DepthImages,
    Images,
    Planning,
):
    """A cloud is a PointCloud, its points as (N, 3) float32 metres, or the handle of a kept one."""
