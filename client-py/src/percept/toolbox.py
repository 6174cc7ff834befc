"""The perception toolbox: one cloud or image in, facts out; no session. Absent parameters take the
server's defaults, which the contract names.

The calls stand in `_toolbox`, one file a group: kept clouds, files and pipelines; filters, sampling and
normals; planes, clusters, shapes and objects; registration; depth and colour images; several
views of one scene; ground, smooth regions, convex parts and pictures.
"""

from __future__ import annotations

from ._toolbox.depth import AsyncDepth, Depth
from ._toolbox.filters import AsyncFilters, Filters
from ._toolbox.images import AsyncImages, Images
from ._toolbox.kept import AsyncKept, Kept
from ._toolbox.regions import AsyncRegions, Regions
from ._toolbox.registration import AsyncRegistrationCalls, RegistrationCalls
from ._toolbox.segmentation import AsyncSegmentation, Segmentation


class Toolbox(Kept, Filters, Segmentation, RegistrationCalls, Depth, Images, Regions):
    """A cloud is a PointCloud, its points as (N, 3) float32 metres, or the handle of a kept one."""


class AsyncToolbox(
    AsyncKept, AsyncFilters, AsyncSegmentation, AsyncRegistrationCalls, AsyncDepth, AsyncImages, AsyncRegions
):
    """A cloud is a PointCloud, its points as (N, 3) float32 metres, or the handle of a kept one."""
