"""How features, degrees of freedom and the rest are named to people."""

from __future__ import annotations

from servoscope.poses import DISPLAY_UNITS, DOFS

DOF_LABELS = {dof: dof.capitalize() for dof in DOFS}
"""``Tx`` for ``tx``, as the paper has it."""

DOF_UNITS = dict(zip(DOFS, DISPLAY_UNITS, strict=True))

FAMILY_NAMES = {
    "gm": "geometric moments",
    "pca": "eigenfeatures",
    "pci": "pose-image covariance",
    "lfa35": "local feature analysis, 35 eigenvectors",
    "lfa85": "local feature analysis, 85 eigenvectors",
}

CRITERION_NAMES = {
    "ideal_point": "ideal point (published)",
    "ideal_point_corrected": "ideal point, corrected",
    "mrmr": "mRMR",
    "jmi": "JMI",
    "cmim": "CMIM",
    "conditional": "conditional information",
    "forecast": "forecast error",
}
"""The criteria of selection in words."""

PROTOCOL_NAMES = {"honest": "Honest protocol", "paper": "Paper's protocol"}

FORM_NAMES = {"pivot": "about the pivot", "camera": "about the camera"}


def feature_family(name: str) -> str:
    """The family of a candidate feature: ``gm``, ``pca`` or ``pci``.

    Examples
    --------
    >>> [feature_family(name) for name in ("theta_50", "e_07", "pci_rz")]
    ['gm', 'pca', 'pci']
    """
    return {"e": "pca", "pci": "pci"}.get(name.split("_")[0], "gm")


def count(number: int, noun: str) -> str:
    """A number with its noun.

    Examples
    --------
    >>> count(1, "feature"), count(2, "feature")
    ('1 feature', '2 features')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
