# Written by client-py/generate from _async/toolbox/shapes.py; change that.
"""Neighbours, local features, boxes, hulls."""

from __future__ import annotations

from ..._arrays import Array
from ..._convert.toolbox import shapes as convert
from ..._convert.toolbox.request import Cloud
from ...types.shapes import Boxes, ConvexHull, LocalFeatures, Neighbours
from ..bound import Bound


class Shapes(Bound):
    """Who is near whom, and what lies around."""

    def find_neighbours(
        self,
        cloud: Cloud,
        *,
        queries: Array | None = None,
        k: int | None = None,
        radius_m: float | None = None,
    ) -> Neighbours:
        """The k nearest points of each query (Q, 3) float32, those within radius_m, or both; exact. Without
        queries of every point, itself among them."""
        return self._transport.call(convert.find_neighbours(cloud, queries, k, radius_m))

    def compute_local_features(self, cloud: Cloud, *, k: int | None = None) -> LocalFeatures:
        """Linearity, planarity, scattering, verticality and curvature of each point's k (20) nearest."""
        return self._transport.call(convert.compute_local_features(cloud, k))

    def fit_boxes(self, cloud: Cloud) -> Boxes:
        """Boxes around a cloud: axis-aligned, upright of least area, of least volume."""
        return self._transport.call(convert.fit_boxes(cloud))

    def compute_convex_hull(self, cloud: Cloud) -> ConvexHull:
        """The convex hull: corners, triangles, volume, area."""
        return self._transport.call(convert.compute_convex_hull(cloud))
