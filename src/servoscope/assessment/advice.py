"""What would help a degree of freedom most, each piece of advice with its number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from servoscope.assessment.verdict import WELL

LEAST_GAIN = 0.1
"""What would change an error by less than this share is not worth saying."""


MUCH = 2.0
"""A disturbance that multiplies an error by more than this is worth a warning."""

FARTHEST = 10.0
"""Nobody moves so many times as far; what is told so badly may not be told at all."""


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
        Error of always answering the mean.
    wished : float or None
    n_images : int
        Learned from.
    told : str
        How well, see `grade`.
    share_left : float
        Error, over all images, as a share of `baseline`: what `told` goes by.
    family : str
        Title of the features that tell it best.
    others : dict
        Forecasts of other candidates by title.
    at_twice, at_five_times : float
        Forecasts with more images.
    images_for_wish : int or None
        How many images the wish needs; None if images alone do not fulfil it.
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
    """

    unit: str
    rms: float
    reached: float
    baseline: float
    wished: float | None
    n_images: int
    told: str
    share_left: float
    family: str
    others: Mapping[str, float]
    at_twice: float
    at_five_times: float
    images_for_wish: int | None
    without_border: float | None
    inner: float | None
    period_px: float | None
    at_random: float | None
    disturbed: Mapping[str, float]

    @property
    def is_met(self) -> bool:
        """Whether forecast and test both fulfil the wish; True where there is none."""
        return self.wished is None or max(self.rms, self.reached) <= self.wished


def advise(found: Findings) -> list[str]:
    """Sentences on what stands in the way, what would help most, and what to beware of."""
    helps = sorted(_helps(found), key=lambda item: item[0])
    return [*_obstacles(found), *(text for _, text in helps), *_warnings(found)]


def _obstacles(found: Findings) -> Iterator[str]:
    """What has to go before anything else can help."""
    if found.period_px is not None and found.told != "well":
        yield (
            f"the view repeats every {found.period_px:.0f} px: start closer than half of that, "
            "or bring something into view that stands there once"
        )
    elif found.told == "not":
        yield (
            f"nothing here tells it: {_says(found.baseline, found)} is what answering the mean "
            "reaches; see whether the part is in view and sharp, and try another view"
        )


def _helps(found: Findings) -> Iterator[tuple[float, str]]:
    """Errors that are hoped for, and how."""
    if found.told == "not":
        yield from _longer_range(found)
        return
    yield from _more_images(found)
    yield from _wider_view(found)
    # Whatever is hardly told errs less near the mean, which is what is answered.
    is_told = found.told in ("well", "roughly")
    if is_told and found.inner is not None and found.inner < (1 - LEAST_GAIN) * found.rms:
        yield (
            found.inner,
            f"approach in two stages: within half the range it is {_says(found.inner, found)}",
        )
    if found.told != "well":
        yield from _longer_range(found)


def _more_images(found: Findings) -> Iterator[tuple[float, str]]:
    if found.wished is not None and not found.is_met:
        if found.rms <= found.wished:
            yield (
                found.wished,
                f"the forecast fulfils the wish, the {_says(found.reached, found)} of the test "
                "images do not: test on more",
            )
        elif found.images_for_wish is not None:
            more = _two_digits(max(found.images_for_wish - found.n_images, 1))
            yield found.wished, f"about {more} more images bring {_says(found.wished, found)}"
        else:
            yield (
                found.at_five_times,
                f"images alone do not bring {_says(found.wished, found)}: five times as many "
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
            f"a wider view helps: without the outer fifth of this one it is "
            f"{_says(found.without_border, found)}, so a fifth more may bring "
            f"{_says(hoped, found)}",
        )
    elif ratio < 1 - LEAST_GAIN:
        yield (
            found.without_border,
            f"a narrower view helps: the middle four fifths alone reach "
            f"{_says(found.without_border, found)}",
        )


def _longer_range(found: Findings) -> Iterator[tuple[float, str]]:
    """How far a dof has to move to be told well by features that stay as noisy as they are.

    An error is less than the features' own noise alone makes, since the range bounds it as well:
    in squares, their inverses add.
    """
    if found.share_left >= 1:
        return
    factor = ((WELL**-2 - 1) / (found.share_left**-2 - 1)) ** 0.5
    if 1 < factor <= FARTHEST:
        yield (
            found.baseline,
            f"a longer range: with features as noisy as these it is told well once it moves "
            f"{factor:.1f} times as far",
        )


def _warnings(found: Findings) -> Iterator[str]:
    if found.others and found.told != "not":
        title, rms = min(found.others.items(), key=lambda item: item[1])
        if rms > (1 + LEAST_GAIN) * found.rms:
            yield f"keep to {found.family}: {title} would reach {_says(rms, found)}"
    if found.disturbed and found.told != "not":
        title, rms = max(found.disturbed.items(), key=lambda item: item[1])
        if rms > MUCH * found.rms:
            yield f"beware of disturbances: {title} makes it {_says(rms, found)}"
    if found.at_random is not None and found.at_random < (1 - LEAST_GAIN) * found.rms:
        yield (
            f"these images are not independent: taken for independent they promise "
            f"{_says(found.at_random, found)}; take images at random poses"
        )


def _two_digits(number: int) -> int:
    return int(float(f"{number:.2g}"))


def _says(value: float, found: Findings) -> str:
    return f"{value:.2g} {found.unit}"
