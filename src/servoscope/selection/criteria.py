"""Criteria that rank features, by name."""

from __future__ import annotations

from collections.abc import Callable

from servoscope.selection.candidates import Candidates
from servoscope.selection.cmim import rank_cmim
from servoscope.selection.conditional import rank_conditional
from servoscope.selection.forward_selection import rank_forward
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.ideal_point_corrected import rank_ideal_point_corrected
from servoscope.selection.jmi import rank_jmi
from servoscope.selection.mrmr import rank_mrmr
from servoscope.selection.ranking import Ranking

Criterion = Callable[[Candidates, int], Ranking]
"""From the candidates and the number of features to rank to their ranking.

A criterion asks `Candidates` for what it needs: information, or the samples `X` and `y` themselves.
"""


def _ideal_point(candidates: Candidates, n_features: int) -> Ranking:
    return rank_ideal_point(candidates.relevance, candidates.pairwise, n_features)


CRITERIA: dict[str, Criterion] = {
    "ideal_point": _ideal_point,
    "ideal_point_corrected": rank_ideal_point_corrected,
    "mrmr": rank_mrmr,
    "jmi": rank_jmi,
    "cmim": rank_cmim,
    "conditional": rank_conditional,
    "forecast": rank_forward,
}
"""What `MutualInfoSelector` takes by name."""
