"""Why a run need not repeat the published numbers."""

from __future__ import annotations

from typing import Any

from servoscope.report.agreement import closeness_to_paper, stands_in_for_paper
from servoscope.report.names import FORM_NAMES
from servoscope.report.run_data import list_units

SCENE = (
    "The part is another one, seen by another camera, lens and lights: the published study had a "
    "real cylinder head before a wrist camera, this one a simulated head of the same kind and "
    "size. Which eigenvector has which number, and which moment tells most, depends on the scene."
)
OTHER_DATA = (
    "These images are not of a cylinder head under the published poses, so only the general "
    "statements are compared; the published numbers beside the tables give a scale, no more."
)
TRAINING = (
    "How nets start and are damped was not published. Here they start nearly linear and are well "
    "damped, so they over-fit little, which helps most where inputs are many and weak: with larger "
    "starts and less damping the errors of PCA grow towards those of PCI."
)
CHANCE = (
    "Nets start at random and the best of a few restarts stands; with one data set and one split, "
    "differences of a few hundredths of the range are within chance, and the published table too "
    "is of one data set, rounded to two decimals."
)
ASSESSED = (
    "Under the paper's protocol information is assessed on all images and decisions fall on the "
    "test images; under the honest one both are kept from them."
)


def explain_differences(summary: dict[str, Any]) -> list[str]:
    """Reasons for what differs, the most important first."""
    if not stands_in_for_paper(summary):
        return [OTHER_DATA, TRAINING, CHANCE, ASSESSED]
    return [SCENE, TRAINING, _forms(summary), CHANCE, ASSESSED]


def _forms(summary: dict[str, Any]) -> str:
    text = (
        "The text of the paper leaves open whether displacements were taken about the pivot in "
        "front of the camera or about the camera itself, where rotation makes Tx and Ty large"
    )
    units = list_units(summary)
    compared = [unit for unit in units if unit.protocol == "paper"] or units
    factors = [
        f"{2 ** closeness_to_paper(unit):.2f} {FORM_NAMES[unit.displacement]}" for unit in compared
    ]
    return (
        f"{text}. The errors of Table I differ from the published ones by a typical factor of "
        f"{' and '.join(factors)}."
    )
