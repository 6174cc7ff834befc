"""Neighbours, local features, boxes, hulls."""

from __future__ import annotations

from ..._arrays import Array
from ..._convert.toolbox import shapes as convert
from ..._convert.toolbox.request import Cloud
from ...types.shapes import Boxes, ConvexHull, LocalFeatures, Neighbours
from ..bound import AsyncBound


class AsyncShapes(AsyncBound):
    """Who is near whom, and what lies around."""

    async def find_neighbours(
        self,
        cloud: Cloud,
        *,
        queries: Array | None = None,
        k: int | None = None,
        radius_m: float | None = None,
    ) -> Neighbours:
        """The k nearest points of each query (Q, 3) float32, those within radius_m, or both; exact. Without
        queries of every point, itself among them."""
        return await self._transport.call(convert.find_neighbours(cloud, queries, k, radius_m))

    async def compute_local_features(self, cloud: Cloud, *, k: int | None = None) -> LocalFeatures:
        """Linearity, planarity, scattering, verticality and curvature of each point's k (20) nearest."""
        return await self._transport.call(convert.compute_local_features(cloud, k))

    async def fit_boxes(self, cloud: Cloud) -> Boxes:
        """Boxes around a cloud: axis-aligned, upright of least area, of least volume."""
        return await self._transport.call(convert.fit_boxes(cloud))

    async def compute_convex_hull(self, cloud: Cloud) -> ConvexHull:
        """The convex hull: corners, triangles, volume, area."""
        return await self._transport.call(convert.compute_convex_hull(cloud))
