"""An assessment as one JSON value: the decision for each dof, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.advice import Findings, advise
from servoscope.assessment.disturbed import TITLES
from servoscope.assessment.outcome import Assessment
from servoscope.assessment.verdict import (
    CONSTANT,
    LEFT_OUT,
    STILL,
    arrives,
    conclude,
    grade,
    is_met,
    name_limit,
    share_out,
)
from servoscope.assessment.view import ViewFindings
from servoscope.features.catalogue import title_of
from servoscope.pipeline import Fitted
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.selection import LearningCurve

TIMES = (1, 2, 5, 10)
"""Numbers of images, in those there are, at which the learning curve is given."""


Array = NDArray[np.float64]

INNER = 0.5
"""Share of the range within which the inner error is taken."""

LEAST_TESTED, CLEARLY_LESS = 30, 0.9

_LARGE, _LEAST_LARGE = 4.0, 5
_NEAR_PERIOD, _MOST_OF_LARGE = 0.2, 0.5


def as_json(
    found: Assessment, tolerances: Mapping[str, float], label_errors: Mapping[str, float]
) -> dict[str, Any]:
    """What an assessment found, in mm and degrees.

    Parameters
    ----------
    found : Assessment
    tolerances, label_errors : dict
        RMS errors that are asked for, and those of the poses that the robot reports, by dof,
        [mm] and [deg].

    Returns
    -------
    dict
        ``dofs[dof]``, the decision; ``conclusion``, the verdict on all of them; ``loop``, of the
        rehearsal; ``images``, what they are like; ``families``, ``regressors`` and ``disturbed``,
        the tables behind.
    """
    scale = dict(zip(DOFS, found.data.ranges() * DISPLAY_FACTORS, strict=True))
    dofs = {
        dof: _decide(found, dof, scale[dof], tolerances.get(dof), label_errors.get(dof))
        if dof in found.decision.choice
        else _still(dof, tolerances.get(dof), dof in (found.sample.real.asked_dofs or DOFS))
        for dof in DOFS
    }
    loop = None if found.view is None else found.view.loop
    return {
        "dofs": dofs,
        "warnings": list(_warnings(found)),
        "conclusion": conclude(dofs, loop),
        "loop": loop,
        "keyframe": None
        if found.view is None
        else {"n_read": found.view.n_read, "share_right": found.view.share_right},
        "images": _images(found),
        "families": {name: _family(found, name, scale) for name in found.decision.candidates},
        "regressors": _regressors(found.regressors, scale),
        "regressors_on_moments": _regressors(found.regressors_on_moments, scale),
        "disturbed": {
            name: {dof: rms * scale[dof] for dof, rms in errors.items()}
            for name, errors in found.disturbed.items()
        },
    }


def _warnings(found: Assessment) -> Iterator[str]:
    """What whoever took the images should know."""
    if found.sample.n_rendered:
        n_learned, n_test = len(found.sample.real_split.learned), len(found.split.test)
        right = found.sample.view.right if found.sample.view else np.ones(0, bool)
        yield (
            f"Few images: features are chosen, forecast and trained on {n_learned} real images and "
            f"{found.sample.n_rendered} rendered by a keyframe of these, which read "
            f"{right.sum()} of {len(right)} others right. The measured errors are of {n_test} "
            "real images that neither has seen."
        )
    if found.independence.kind == "sequence":
        yield (
            "These images come in a sequence: whole blocks of it are kept for testing, since "
            "neighbouring images would flatter every number."
        )
        if found.view is not None and found.view.loop is not None:
            yield (
                "Where the loop ends is what the noise of the pixels alone would leave. Poses and "
                "frames of a sequence are often off by more; one look has these errors in it."
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


def _still(dof: str, tolerance: float | None, is_asked: bool) -> dict[str, Any]:
    """A dof of which nothing can be said."""
    return {
        "forecast_rms": None,
        "interval": None,
        "reached_rms": None,
        "reached_interval": None,
        "split_rms": None,
        "unit": DISPLAY_UNITS[DOFS.index(dof)],
        "limited_by": STILL if is_asked else LEFT_OUT,
        "best_features": [],
        "advice": ["take images in which it moves"] if is_asked else [],
        "observable": "still",
        "tolerance": tolerance,
        "one_look": None,
        "view_limit": None,
        "loop": None,
        "met_in_one_look": is_met(None, {"tolerance": tolerance}),
        "met_in_loop": is_met(None, {"tolerance": tolerance}),
    }


def _decide(
    found: Assessment, dof: str, scale: float, tolerance: float | None, label_error: float | None
) -> dict[str, Any]:
    i, name = DOFS.index(dof), found.decision.choice[dof]
    decision, curve = found.decision, found.curves[dof]
    forecast, fitted, measured = decision.forecasts[dof], decision.fitted[dof], found.measured
    rms, baseline = float(forecast.rms[0]), float(forecast.baseline[0])
    observable = grade(_share_left(found, rms, measured.rms(dof), baseline))
    images = {times: rms * _falls_to(curve, times) for times in TIMES}
    budget = share_out(
        rms,
        noise=found.noise[dof],
        labels=(label_error or 0.0) / scale,
        at_ten_times=images[10],
        best_regressor=_best_regressor(found, dof, rms),
    )
    findings = _find(found, dof, scale, tolerance, images, observable)
    reached = {
        "rms": measured.rms(dof) * scale,
        "interval": [end * scale for end in measured.interval(dof)],
        "by": "features",
    }
    row: dict[str, Any] = {
        "forecast_rms": rms * scale,
        "interval": [end * scale for end in decision.interval_of(forecast, found.measured)],
        "reached_rms": reached["rms"],
        "reached_interval": reached["interval"],
        "split_rms": fitted.test_rms * scale,
        "unit": DISPLAY_UNITS[i],
        "limited_by": CONSTANT
        if not found.images.change
        else name_limit(
            observable,
            budget,
            is_at_period=findings.period_px is not None,
            rms=measured.rms(dof) * scale,
            view_limit=findings.view_limit,
        ),
        "best_features": list(found.best_features[dof]),
        "advice": advise(findings)
        if found.images.change
        else ["nothing can be learned: every image is the same; check camera and exposure"],
        "observable": observable,
        "tolerance": tolerance,
        "one_look": reached,
        "view_limit": findings.view_limit,
        "loop": None,
        "family": title_of(name),
        "baseline_rms": baseline * scale,
        "coverage_95": fitted.coverage,
        "budget": asdict(budget),
        "learning_curve": {
            "n_images": [times * int(curve.n_images[-1]) for times in TIMES],
            "rms": [images[times] * scale for times in TIMES],
        },
    }
    if found.view is not None:
        row |= _by_keyframe(found.view, dof, reached)
    row["met_in_one_look"] = is_met(row["one_look"]["rms"], row)
    row["met_in_loop"] = is_met(findings.loop, row)
    return row


def _by_keyframe(view: ViewFindings, dof: str, reached: dict[str, Any]) -> dict[str, Any]:
    """What a keyframe says of a dof; one look is by it or by features, whichever errs less."""
    by_keyframe = {"rms": view.rms[dof], "interval": list(view.interval[dof]), "by": "keyframe"}
    ends, loop = view.loop["end_rms"], view.loop
    return {
        "one_look": min(by_keyframe, reached, key=lambda look: look["rms"]),
        "loop": {
            "end_rms": None if ends is None else ends[dof],
            "success": loop["success"],
            "moves": loop["moves"],
        },
    }


def _find(
    found: Assessment,
    dof: str,
    scale: float,
    tolerance: float | None,
    images: Mapping[int, float],
    observable: str,
) -> Findings:
    i, name = DOFS.index(dof), found.decision.choice[dof]
    decision, curve = found.decision, found.curves[dof]
    forecast, candidate = decision.forecasts[dof], decision.candidates[name]
    narrower, view = found.without_border.get(dof), found.view
    level = _ratio(
        images[1], float(candidate.forecasts[dof].rms[0])
    )  # of full effort over a glance
    on_curve = _ratio(float(curve.rms_at(curve.n_images[-1]).rms[0]), images[1])
    ends = view.loop["end_rms"] if view is not None and arrives(view.loop) else None
    return Findings(
        unit=DISPLAY_UNITS[i],
        rms=images[1] * scale,
        reached=found.measured.rms(dof) * scale,
        baseline=float(forecast.baseline[0]) * scale,
        tolerance=tolerance,
        n_images=int(curve.n_images[-1]),
        observable=observable,
        at_twice=images[2] * scale,
        at_five_times=images[5] * scale,
        images_for_tolerance=None
        if tolerance is None
        else curve.images_for(on_curve * tolerance / scale)[0],
        without_border=None if narrower is None else level * narrower * scale,
        inner=_scaled(inner_rms(forecast.residuals[:, 0], found.learned_targets[:, i]), scale),
        period_px=_period_of_errors(found, dof, scale, observable),
        at_random=None if found.at_random is None else level * found.at_random[dof] * scale,
        disturbed={
            TITLES[disturbance]: errors[dof] * scale
            for disturbance, errors in found.disturbed.items()
            if disturbance != "clean"
        },
        view_limit=None if view is None else view.limit[dof],
        keyframe=None if view is None else view.rms[dof],
        loop=None if ends is None else ends[dof],
    )


def _period_of_errors(found: Assessment, dof: str, scale: float, observable: str) -> float | None:
    """The period of the view in pixels, if the large errors of a translation cluster at it.

    Where no keyframe says how many mm that is, it is blamed for what is hardly observable.
    """
    shift = found.images.repetition.shift
    if not found.images.repetition.repeats:
        return None
    if found.view is None:
        return float(np.hypot(*shift)) if observable in ("hardly", "not") else None
    if dof not in ("tx", "ty"):
        return None
    keyframe = found.view.model.keyframe
    focal = keyframe.camera.f * keyframe.reference_image.shape[1]
    period_px = float(np.hypot(*shift))
    period = 1e3 * period_px / focal / float(np.median(keyframe.inverse_depth))
    errors = np.abs(found.decision.forecasts[dof].residuals[:, 0]) * scale
    large = errors[errors > _LARGE * np.median(errors)]
    near = np.abs(large - period) < _NEAR_PERIOD * period
    is_cluster = len(large) >= _LEAST_LARGE and near.mean() > _MOST_OF_LARGE
    return period_px if is_cluster else None


def inner_rms(residuals: Array, targets: Array) -> float | None:
    """RMS of the residuals where a target is within half its range; None where hardly any is.

    Parameters
    ----------
    residuals, targets : ndarrays of shape (n,)
        In units of the range.
    """
    inner = np.abs(targets) <= INNER
    if np.count_nonzero(inner) < 20:
        return None
    return float(np.sqrt(np.mean(residuals[inner] ** 2)))


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale


def _share_left(found: Assessment, forecast: float, reached: float, baseline: float) -> float:
    """Error, over all images, as a share of that of predicting the mean."""
    n_test = len(found.measured.images)
    n_learned = len(found.sample.real_split.learned)
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
    images, repetition, sample = found.images, found.images.repetition, found.sample
    measured = found.measured
    split = {part: indices.tolist() for part, indices in vars(sample.split).items()}
    return {
        "independence": found.independence.kind,
        "independence_ratio": found.independence.ratio,
        "n_train": len(sample.real_split.train),
        "n_validation": len(sample.real_split.validation),
        "n_test": len(sample.split.test),
        "n_tested": len(measured.images),
        "n_tested_groups": len(np.unique(measured.groups)),
        "n_splits": measured.n_splits,
        "n_given": sample.real.source.get("thinned_from", len(sample.real)),
        "n_used": len(sample.real),
        "n_rendered": sample.n_rendered,
        **({"split": split} if sample.n_rendered else {}),
        "n_copies": images.n_copies,
        "noise_grey": images.noise,
        "repeats": repetition.repeats,
        "repetition_correlation": repetition.correlation,
        "repetition_shift_px": list(repetition.shift),
    }


def _family(found: Assessment, name: str, scale: Mapping[str, float]) -> dict[str, Any]:
    candidate = found.decision.candidates[name]
    return {
        "title": title_of(name),
        "n_features": candidate.n_features,
        "dofs": {
            dof: {
                "forecast_rms": float(forecast.rms[0]) * scale[dof],
                "interval": [
                    end * scale[dof] for end in found.decision.interval_of(forecast, found.measured)
                ],
                "reached_rms": found.measured.rms(dof) * scale[dof]
                if found.decision.choice[dof] == name
                else None,
            }
            for dof, forecast in candidate.forecasts.items()
        },
    }
