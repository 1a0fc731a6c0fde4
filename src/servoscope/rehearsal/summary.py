"""The numbers and the words of a rehearsal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import binomtest

from servoscope.scoreboard.summary import summarise
from servoscope.scoreboard.trial import Trial

ENOUGH = 0.95
"""Share of the starts that has to arrive for a condition to be called safe."""


def summarise_rehearsal(trials: Sequence[Trial]) -> dict[str, Any]:
    """The numbers of one condition, as plain JSON values.

    Parameters
    ----------
    trials : sequence of Trial
        One at least.
    """
    numbers = summarise(trials)
    del numbers["decision_ms_median"]  # another one at every run
    found = binomtest(numbers["success"], numbers["trials"]).proportion_ci(method="wilson")
    wrong = sum(trial.status == "converged" and not trial.succeeded for trial in trials)
    return {
        **numbers,
        "success_interval": [round(float(found.low), 4), round(float(found.high), 4)],
        "wrongly_converged": wrong,
    }


def verdict(results: Mapping[str, Mapping[str, Any]]) -> str:
    """One sentence: where the camera would arrive, and where not.

    Examples
    --------
    >>> verdict({"range_1.0": {"success": 19, "trials": 20, "wrongly_converged": 0}})
    "At least 95% of 20 starts would arrive under range_1.0; no runs say 'converged' farther away."
    """
    shares = {name: numbers["success"] / numbers["trials"] for name, numbers in results.items()}
    few = {name: share for name, share in shares.items() if share < ENOUGH}
    wrong = sum(numbers["wrongly_converged"] for numbers in results.values())
    n_starts = max(numbers["trials"] for numbers in results.values())
    where = "under every condition" if len(shares) > 1 else f"under {next(iter(shares))}"
    if not few:
        said = f"At least {ENOUGH:.0%} of {n_starts} starts would arrive {where}"
    else:
        weak = ", ".join(f"{name} ({share:.0%})" for name, share in few.items())
        rest = len(shares) - len(few)
        fewer = f"fewer than {ENOUGH:.0%} of {n_starts} starts would arrive under {weak}"
        others = f"; under the other {rest} at least as many would" if rest else ""
        said = fewer[0].upper() + fewer[1:] + others
    runs = "run says" if wrong == 1 else "runs say"
    trust = f"{wrong or 'no'} {runs} 'converged' farther away"
    return f"{said}; {trust}."
