"""Points that are spread out."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from splatmorph.geometry.spreading import farthest

POINTS = np.random.default_rng(0).normal(size=(200, 3))


@settings(max_examples=20, deadline=None)
@given(count=st.integers(1, 199), first=st.none() | st.integers(0, 199))
def test_they_cover_better_than_any_gap_between_them(count: int, first: int | None) -> None:
    kept = farthest(POINTS, count, first=first)
    assert len(set(kept.tolist())) == count
    assert first is None or kept[0] == first
    # The law of farthest-point sampling: every point is nearer to a chosen one than the two
    # nearest chosen ones are to each other.
    chosen = cdist(POINTS[kept], POINTS[kept]) + np.eye(count) * 1e9
    assert cdist(POINTS, POINTS[kept]).min(1).max() <= chosen.min() + 1e-12


def test_more_are_taken_where_distances_are_stretched() -> None:
    right = POINTS[:, 0] > 0
    even, uneven = (farthest(POINTS, 40, first=0, stretch=1 + share * right) for share in (0, 3))
    assert right[uneven].sum() > right[even].sum() + 5


def test_none_and_all() -> None:
    assert len(farthest(POINTS, 0)) == 0
    assert len(farthest(POINTS[:0], 3)) == 0
    assert np.array_equal(farthest(POINTS, 300), np.arange(200))
