"""An assessment as one JSON value: the decision for each dof, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from servoscope.assessment.advice import Findings, advise
from servoscope.assessment.budget import share_out
from servoscope.assessment.disturbed import TITLES
from servoscope.assessment.outcome import Assessment
from servoscope.assessment.verdict import CONSTANT, STILL, conclude, grade, name_limit
from servoscope.assessment.what_if import inner_rms
from servoscope.features.catalogue import title_of
from servoscope.pipeline import Fitted
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.selection import LearningCurve
from servoscope.selection.rms_interval import rms_interval

TIMES = (1, 2, 5, 10)
"""Numbers of images, in those there are, at which the learning curve is told."""


LEAST_TESTED, CLEARLY_LESS = 30, 0.9


def as_json(
    found: Assessment, wishes: Mapping[str, float], label_errors: Mapping[str, float]
) -> dict[str, Any]:
    """What an assessment found, in mm and degrees.

    Parameters
    ----------
    found : Assessment
    wishes, label_errors : dict
        Wished RMS errors, and those of the poses that the robot tells, by dof, [mm] and [deg].

    Returns
    -------
    dict
        ``dofs[dof]``, the decision; ``conclusion``, one sentence on all of them; ``images``,
        what they are like; ``families``, ``regressors`` and ``disturbed``, the tables behind.
    """
    scale = dict(zip(DOFS, found.data.ranges() * DISPLAY_FACTORS, strict=True))
    dofs = {
        dof: _decide(found, dof, scale[dof], wishes.get(dof), label_errors.get(dof))
        if dof in found.choice
        else _still(dof, wishes.get(dof))
        for dof in DOFS
    }
    return {
        "dofs": dofs,
        "warnings": list(_warnings(found)),
        "conclusion": conclude(
            {dof: row["share_left"] for dof, row in dofs.items() if dof in found.choice}
        ),
        "images": _images(found),
        "families": {name: _family(found, name, scale) for name in found.candidates},
        "regressors": _regressors(found.regressors, scale),
        "regressors_on_moments": _regressors(found.regressors_on_moments, scale),
        "disturbed": {
            name: {dof: rms * scale[dof] for dof, rms in errors.items()}
            for name, errors in found.disturbed.items()
        },
    }


def _warnings(found: Assessment) -> Iterator[str]:
    """What whoever took the images should know."""
    if found.independence.kind == "sequence":
        yield (
            "These images come in a sequence: whole blocks of it are kept for testing, since "
            "neighbouring images would flatter every number."
        )
    if found.independence.kind == "revisited":
        yield (
            "These images were taken at few places, or come from a sequence in no order: whole "
            "clusters of poses are kept for testing, since near copies would flatter every number."
        )
    if found.images.repetition.repeats:
        x, y = found.images.repetition.shift
        yield (
            f"The reference view looks like itself when shifted by {x:.0f} px along x and {y:.0f} "
            "px along y: poses that far apart are taken for each other."
        )
    if found.images.n_copies and found.images.change:
        yield f"Exact copies of other images: {found.images.n_copies}. Was the camera frozen?"


def _still(dof: str, wished: float | None) -> dict[str, Any]:
    """A dof of which nothing can be said."""
    return {
        "forecast_rms": None,
        "interval": None,
        "reached_rms": None,
        "reached_interval": None,
        "unit": DISPLAY_UNITS[DOFS.index(dof)],
        "limited_by": STILL,
        "best_features": [],
        "advice": ["take images in which it moves"],
        "told": "still",
        "wanted": wished,
        "met": None,
    }


def _decide(
    found: Assessment, dof: str, scale: float, wished: float | None, label_error: float | None
) -> dict[str, Any]:
    i, name = DOFS.index(dof), found.choice[dof]
    forecast, fitted, curve = found.forecasts[dof], found.fitted[dof], found.curves[dof]
    rms, baseline = float(forecast.rms[0]), float(forecast.baseline[0])
    left = _share_left(found, rms, fitted.test_rms, baseline)
    told = grade(left)
    images = {times: rms * _falls_to(curve, times) for times in TIMES}
    budget = share_out(
        rms,
        noise=found.noise[dof],
        labels=(label_error or 0.0) / scale,
        at_ten_times=images[10],
        best_regressor=_best_regressor(found, dof, rms),
    )
    findings = _find(found, dof, scale, wished, images, left)
    return {
        "forecast_rms": rms * scale,
        "interval": (forecast.interval[:, 0] * scale).tolist(),
        "reached_rms": fitted.test_rms * scale,
        "reached_interval": _reached_interval(found, dof, scale),
        "unit": DISPLAY_UNITS[i],
        "limited_by": CONSTANT
        if not found.images.change
        else name_limit(told, budget, found.images.repetition),
        "best_features": list(found.best_features[dof]),
        "advice": advise(findings)
        if found.images.change
        else ["nothing can be learned: every image is the same; check camera and exposure"],
        "told": told,
        "share_left": left,
        "wanted": wished,
        "met": None if wished is None else findings.is_met,
        "family": title_of(name),
        "baseline_rms": baseline * scale,
        "coverage_95": fitted.coverage,
        "information_alone": float(forecast.entropy_power.joint[0]) * scale,
        "budget": asdict(budget),
        "learning_curve": {
            "n_images": [times * int(curve.n_images[-1]) for times in TIMES],
            "rms": [images[times] * scale for times in TIMES],
        },
    }


def _reached_interval(found: Assessment, dof: str, scale: float) -> list[float]:
    """90 % interval of the error on test images, of which there are only so many groups."""
    groups = found.independence.labels[found.split.test]
    errors = found.fitted[dof].errors[:, None]
    several = len(np.unique(groups)) > 1
    return [float(end) * scale for end in rms_interval(errors, groups if several else None)[:, 0]]


def _find(
    found: Assessment,
    dof: str,
    scale: float,
    wished: float | None,
    images: Mapping[int, float],
    share_left: float,
) -> Findings:
    i, name = DOFS.index(dof), found.choice[dof]
    forecast, curve, candidate = found.forecasts[dof], found.curves[dof], found.candidates[name]
    narrower, repetition = found.without_border.get(dof), found.images.repetition
    level = _ratio(
        images[1], float(candidate.forecasts[dof].rms[0])
    )  # of full effort over a glance
    on_curve = _ratio(float(curve.rms_at(curve.n_images[-1]).rms[0]), images[1])
    return Findings(
        unit=DISPLAY_UNITS[i],
        rms=images[1] * scale,
        reached=found.fitted[dof].test_rms * scale,
        baseline=float(forecast.baseline[0]) * scale,
        wished=wished,
        n_images=int(curve.n_images[-1]),
        told=grade(share_left),
        share_left=share_left,
        family=title_of(name),
        others={
            title_of(other): float(one.forecasts[dof].rms[0]) * scale
            for other, one in found.candidates.items()
            if other == "moments" and other != name
        },
        at_twice=images[2] * scale,
        at_five_times=images[5] * scale,
        images_for_wish=None if wished is None else curve.images_for(on_curve * wished / scale)[0],
        without_border=None if narrower is None else level * narrower * scale,
        inner=_scaled(inner_rms(forecast.residuals[:, 0], found.learned_targets[:, i]), scale),
        period_px=float(np.hypot(*repetition.shift)) if repetition.repeats else None,
        at_random=None if found.at_random is None else level * found.at_random[dof] * scale,
        disturbed={
            TITLES[disturbance]: errors[dof] * scale
            for disturbance, errors in found.disturbed.items()
            if disturbance != "clean"
        },
    )


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale


def _share_left(found: Assessment, forecast: float, reached: float, baseline: float) -> float:
    """Error, over all images, as a share of that of always answering the mean."""
    n_test = len(found.split.test)
    n_learned = len(found.split.train) + len(found.split.validation)
    squares = n_learned * forecast**2 + n_test * reached**2
    return float(np.sqrt(squares / (n_learned + n_test))) / baseline if baseline > 0 else 1.0


def _falls_to(curve: LearningCurve, times: int) -> float:
    """Share of the error that is left with some times the images."""
    n_images = int(curve.n_images[-1])
    now, then = (float(curve.rms_at(n).rms[0]) for n in (n_images, times * n_images))
    return min(_ratio(then, now), 1.0)


def _ratio(a: float, b: float) -> float:
    """How many times as large an error is as another; 1 where there is no other."""
    return a / b if b > 0 else 1.0


def _best_regressor(found: Assessment, dof: str, rms: float) -> float:
    """What the forecast would be with the regressor that did best on the test images.

    The least of several errors on few images is a little less by chance alone: it counts from
    `LEAST_TESTED` images on, and if it is clearly less.
    """
    reached = {one.recipe.regressor: one.test_rms for one in found.regressors if one.dof == dof}
    if not reached:
        return rms
    share = _ratio(min(reached.values()), reached["gaussian_process"])
    is_clear = len(found.split.test) >= LEAST_TESTED and share <= CLEARLY_LESS
    return rms * share if is_clear else rms


def _regressors(compared: Sequence[Fitted], scale: Mapping[str, float]) -> list[dict[str, Any]]:
    rows = []
    for name in dict.fromkeys(one.recipe.regressor for one in compared):
        scores = [one for one in compared if one.recipe.regressor == name]
        rows.append(
            {
                "regressor": name,
                "rms": {one.dof: one.test_rms * scale[one.dof] for one in scores},
                "seconds": sum(one.seconds for one in scores),
                "coverage_95": float(np.mean([one.coverage for one in scores])),
            }
        )
    return rows


def _images(found: Assessment) -> dict[str, Any]:
    images, repetition = found.images, found.images.repetition
    return {
        "independence": found.independence.kind,
        "independence_ratio": found.independence.ratio,
        "n_train": len(found.split.train),
        "n_validation": len(found.split.validation),
        "n_test": len(found.split.test),
        "n_copies": images.n_copies,
        "noise_grey": images.noise,
        "repeats": repetition.repeats,
        "repetition_correlation": repetition.correlation,
        "repetition_shift_px": list(repetition.shift),
    }


def _family(found: Assessment, name: str, scale: Mapping[str, float]) -> dict[str, Any]:
    candidate = found.candidates[name]
    return {
        "title": title_of(name),
        "n_features": candidate.n_features,
        "dofs": {
            dof: {
                "forecast_rms": float(forecast.rms[0]) * scale[dof],
                "interval": (forecast.interval[:, 0] * scale[dof]).tolist(),
                "reached_rms": found.fitted[dof].test_rms * scale[dof]
                if found.choice[dof] == name
                else None,
            }
            for dof, forecast in candidate.forecasts.items()
        },
    }
