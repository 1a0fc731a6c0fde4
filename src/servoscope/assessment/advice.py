"""What would help a degree of freedom most, each piece of advice with its number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from servoscope.wording import plain_number

LEAST_GAIN = 0.1
"""What would change an error by less than this share is not worth saying."""


MUCH = 2.0
"""A disturbance that multiplies an error by more than this is worth a warning."""

MOST_LINES = 3
"""Of advice for one dof."""


@dataclass(frozen=True)
class Findings:
    """What was measured of one dof, as advice needs it; errors in `unit`.

    Parameters
    ----------
    unit : str
        ``"mm"`` or ``"deg"``.
    rms, reached : float
        Forecast, and on the test images.
    baseline : float
        Error of predicting the mean.
    tolerance : float or None
    n_images : int
        Learned from.
    observable : str
        How well, see `grade`.
    at_twice, at_five_times : float
        Forecasts with more images.
    images_for_tolerance : int or None
        How many images the tolerance needs; None if images alone do not meet it.
    without_border : float or None
        Forecast from the middle of the view.
    inner : float or None
        Forecast within half the range.
    period_px : float or None
        After how many pixels the view repeats, if it does.
    at_random : float or None
        What a forecast says that takes images of one sequence for independent ones.
    disturbed : dict
        Errors on disturbed test images by what disturbs them, in words.
    view_limit : float or None
        What no estimate from one image goes below.
    keyframe, loop : float or None
        RMS error of one image by a keyframe, and at the end of the rehearsed loop.
    """

    unit: str
    rms: float
    reached: float
    baseline: float
    tolerance: float | None
    n_images: int
    observable: str
    at_twice: float
    at_five_times: float
    images_for_tolerance: int | None
    without_border: float | None
    inner: float | None
    period_px: float | None
    at_random: float | None
    disturbed: Mapping[str, float]
    view_limit: float | None = None
    keyframe: float | None = None
    loop: float | None = None

    @property
    def is_met(self) -> bool:
        """Whether forecast and test both meet the tolerance; True where there is none."""
        return self.tolerance is None or max(self.rms, self.reached) <= self.tolerance

    @property
    def is_met_by_keyframe(self) -> bool:
        """Whether a keyframe meets it, in one look or at the end of the loop."""
        best = min((e for e in (self.keyframe, self.loop) if e is not None), default=None)
        return best is not None and self.tolerance is not None and best <= self.tolerance


def advise(found: Findings) -> list[str]:
    """What stands in the way, what would help most, and what to beware of: three lines at most.

    Where the view itself is the limit, nothing else can help, and nothing else is said; nor where
    a keyframe meets what is asked for and the features do not.
    """
    if found.tolerance is not None and _above(found.view_limit, found.tolerance):
        return [
            f"no image of this view tells it better than {_says(found.view_limit, found)}: come "
            "nearer, or use a longer lens or more pixels"
        ]
    by_keyframe = list(_by_keyframe(found))
    if found.is_met_by_keyframe and by_keyframe:
        return [text for _, text in by_keyframe]
    whose = "" if found.keyframe is None and found.loop is None else "from features, "
    of_features = [(hoped, f"{whose}{text}") for hoped, text in _helps(found)]
    helps = sorted([*by_keyframe, *of_features], key=lambda item: item[0])
    lines = [*_obstacles(found), *(text for _, text in helps), *_warnings(found)]
    return lines[:MOST_LINES]


def _above(limit: float | None, tolerance: float) -> bool:
    return limit is not None and limit > tolerance


def _by_keyframe(found: Findings) -> Iterator[tuple[float, str]]:
    """What a keyframe brings that these features do not."""
    if found.loop is not None and (found.tolerance is None or found.is_met_by_keyframe):
        if not found.is_met or found.loop < (1 - LEAST_GAIN) * found.rms:
            yield (
                found.loop,
                f"position by a keyframe: the loop ends at {_says(found.loop, found)}",
            )
    elif found.keyframe is not None and found.keyframe < (1 - LEAST_GAIN) * found.reached:
        yield (
            found.keyframe,
            f"read it by a keyframe: {_says(found.keyframe, found)} from one image",
        )


def _obstacles(found: Findings) -> Iterator[str]:
    """What has to go before anything else can help."""
    if found.period_px is not None:
        yield (
            f"the view repeats every {found.period_px:.0f} px: start closer than half of that, or "
            "bring something into view that stands there once"
        )
    elif found.observable == "not" and found.keyframe is None:
        yield (
            f"no feature predicts it better than its mean, {_says(found.baseline, found)}: see "
            "whether the part is in view and sharp, and try another view"
        )


def _helps(found: Findings) -> Iterator[tuple[float, str]]:
    """Errors that are hoped for, and how."""
    if found.observable == "not":
        return
    yield from _more_images(found)
    yield from _wider_view(found)
    # Whatever is hardly observable errs less near the mean, which is what is predicted.
    is_observable = found.observable in ("well", "roughly")
    if is_observable and found.inner is not None and found.inner < (1 - LEAST_GAIN) * found.rms:
        yield (
            found.inner,
            f"approach in two stages: within half the range it is {_says(found.inner, found)}",
        )


def _more_images(found: Findings) -> Iterator[tuple[float, str]]:
    if found.tolerance is not None and not found.is_met:
        if found.rms <= found.tolerance:
            yield (
                found.tolerance,
                f"the forecast meets the tolerance, the {_says(found.reached, found)} of the test "
                "images do not: test on more",
            )
        elif found.images_for_tolerance is not None:
            more = _two_digits(max(found.images_for_tolerance - found.n_images, 1))
            yield found.tolerance, f"about {more} more images bring {_says(found.tolerance, found)}"
        else:
            yield (
                found.at_five_times,
                f"images alone do not bring {_says(found.tolerance, found)}: five times as many "
                f"bring {_says(found.at_five_times, found)}",
            )
    elif found.at_five_times < (1 - LEAST_GAIN) * found.rms:
        yield (
            found.at_five_times,
            f"twice the images bring {_says(found.at_twice, found)}, five times "
            f"{_says(found.at_five_times, found)}",
        )


def _wider_view(found: Findings) -> Iterator[tuple[float, str]]:
    if found.without_border is None or found.without_border <= 0:
        return
    ratio = found.without_border / found.rms
    if ratio > 1 + LEAST_GAIN:
        hoped = found.rms / ratio
        yield (
            hoped,
            f"a wider view: without the outer fifth of this one it is "
            f"{_says(found.without_border, found)}, so a fifth more may bring "
            f"{_says(hoped, found)}",
        )
    elif ratio < 1 - LEAST_GAIN:
        yield (
            found.without_border,
            f"a narrower view: the middle four fifths alone reach "
            f"{_says(found.without_border, found)}",
        )


def _warnings(found: Findings) -> Iterator[str]:
    if found.at_random is not None and found.at_random < (1 - LEAST_GAIN) * found.rms:
        yield (
            f"these images are not independent: taken for independent they promise "
            f"{_says(found.at_random, found)}; take images at random poses"
        )
    if found.disturbed and found.observable != "not":
        title, rms = max(found.disturbed.items(), key=lambda item: item[1])
        if rms > MUCH * found.rms:
            yield f"beware of disturbances: {title} makes it {_says(rms, found)}"


def _two_digits(number: int) -> int:
    return int(float(f"{number:.2g}"))


def _says(value: float | None, found: Findings) -> str:
    return f"{plain_number(value or 0.0)} {found.unit}"
