# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reference paths from geometry, in parts, for tests of motion."""

import numpy as np

from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath


def reference_parts(
    geometry: PathGeometry,
    chunk: int,
    *,
    feed: np.ndarray | float = np.inf,
    rest: float = 0.0,
    place: float = 0.0,
    last: bool = True,
) -> list[ReferencePath]:
    """Return a path in parts of `chunk` pieces; it rests for `rest` at inner stops."""
    count = len(geometry.coefficient)
    whole = ReferencePath.of_geometry(geometry)
    stop, curvature = whole.stop, whole.curvature
    stop[0], stop[-1] = place == 0.0, last
    feeds = np.broadcast_to(feed, (count,))
    found = []
    for begin in range(0, count, chunk):
        pieces, nodes = slice(begin, begin + chunk), slice(begin, begin + chunk + 1)
        found.append(
            ReferencePath(
                geometry=geometry.part(begin, min(begin + chunk, count)),
                place=place + float(geometry.node[begin]),
                curvature=curvature[nodes],
                owner=np.arange(count)[pieces],
                blend=np.zeros(count, bool)[pieces],
                feed=feeds[pieces],
                stop=stop[nodes],
                rest=(rest * geometry.stop)[nodes],
            )
        )
    return found
