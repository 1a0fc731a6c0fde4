"""What stands under each kind of figure, and what is read aloud in its place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Words of a figure.

    Parameters
    ----------
    title : str
    text : str
        What one sees.
    alt : str
        What a reader who cannot see it is told.
    paper_figure : int, optional
        The figure of the paper that it is the counterpart of.
    """

    title: str
    text: str
    alt: str
    paper_figure: int | None = None


SIGNED = "Pale is positive, dark negative, middle grey zero; each panel has its own scale."

CAPTIONS = {
    "reach": Caption(
        "What each degree of freedom reaches",
        "RMS errors as shares of the error of predicting the mean, which is the dashed line: "
        "the forecast with its 90 % interval, what a trained model reached on test images, and "
        "what is asked for. Below each stands the forecast.",
        "A chart of forecast, reached and wanted errors by degree of freedom.",
    ),
    "budgets": Caption(
        "Where the error comes from",
        "Shares of the squared error of each degree of freedom. Too few images: what ten times as "
        "many would take away; weak features: what is left.",
        "Stacked bars, one for each degree of freedom, of shares of the squared error.",
    ),
    "behind": Caption(
        "More images, and how good forecasts are",
        "Left: forecast errors with 1, 2, 5 and 10 times the images. Right: forecast against "
        "reached errors, one mark for each family and degree of freedom; dotted lines are at 0.75 "
        "and 1.33. Errors are shares of the error of predicting the mean; translations are "
        "dark.",
        "A chart of errors against numbers of images, and one of reached against forecast errors.",
    ),
    "reference": Caption(
        "Reference image",
        "The view that the camera is to return to.",
        "The reference image, in grey.",
    ),
    "errors": Caption(
        "Errors of every family",
        "Each mark is the error of nets that take one family; dashes, where there are any, are "
        "the published errors. Under each degree of freedom stands the error of the best family.",
        "A chart of RMS test errors by degree of freedom, one mark for each family.",
    ),
    "overview": Caption(
        "Overview",
        "The reference image, its slices, and the errors of every family.",
        "The reference image and its slices beside a chart of RMS errors by degree of freedom.",
    ),
    "slices": Caption(
        "Reference image and intensity slices",
        "The pixels of each interval of grey levels, stretched to show their differences; all "
        "others are white. The geometric moments are taken of each slice.",
        "The reference image and the parts of it that fall in three intervals of grey levels.",
        3,
    ),
    "eigenvectors": Caption(
        "First twelve eigenvectors of the training images",
        f"In order of variance. {SIGNED} They are the same for both forms of the displacement.",
        "Twelve signed pictures, from broad patterns to finer ones.",
        4,
    ),
    "pci": Caption(
        "Pose-image covariance vectors",
        f"How each pixel varies with each degree of freedom. {SIGNED}",
        "Six signed pictures, one for each degree of freedom.",
        5,
    ),
    "covariance": Caption(
        "Pose-LFA covariance, from 85 eigenvectors",
        "Covariance of the output of the receptive field at each pixel with each degree of "
        f"freedom. {SIGNED}",
        "Six signed pictures of fine structure, one for each degree of freedom.",
        6,
    ),
    "filtered": Caption(
        "Pose-LFA covariance, filtered, with the chosen locations",
        "Magnitude of the covariance gathered by a centre-weighted mask; bright is much. "
        "Crosses mark the twelve receptive fields chosen for each degree of freedom.",
        "Six grey pictures with twelve crosses each, on their brightest spots.",
        7,
    ),
    "lfa": Caption(
        "First receptive field chosen for each degree of freedom",
        f"Its weight at each pixel. {SIGNED}",
        "Six signed pictures, each with one strong spot.",
        8,
    ),
    "best": Caption(
        "Each degree of freedom against the feature selected first for it",
        "One dot an image. A narrow band means that this feature alone nearly determines the "
        "displacement; a cloud, that it does not.",
        "Six scatter plots of a displacement against a feature.",
        9,
    ),
    "plane": Caption(
        "Selection plane at step 4",
        "Each candidate by its information about the degree of freedom (up) and the sum of its "
        "information about the three features selected before (right). Curves join equal "
        "distances to the ideal point, on the left edge at the height of the best candidate; the "
        "nearest is circled and named. Circles are moments, squares eigenfeatures, triangles PCI.",
        "Six scatter plots of candidates with contours around the ideal point at the top left.",
        10,
    ),
    "redundancy": Caption(
        "How much of the redundancy is bias",
        "Sum of the information of the feature that the ideal-point rule selects at each step "
        "about those selected before it. Dashed, shaded: the bias in it by the number of occupied "
        "cells (Miller-Madow), which is too little where there are few images. Dotted: what as "
        "many unrelated features would show by chance.",
        "Six charts of redundancy against step, which grows nearly in proportion, and two curves "
        "of bias that grow with it.",
    ),
    "criteria": Caption(
        "Criteria side by side",
        "RMS test error of nets against the number of features that each criterion selected; the "
        "level line is the error with all candidates. Same images, same nets for every criterion.",
        "Charts of error against number of features, one for each degree of freedom, with a line "
        "for each criterion.",
    ),
    "sweep": Caption(
        "RMS error against the threshold of mutual information",
        "The number at each marker counts the ranked features whose information is above the "
        "threshold. Left axis: share of the range; right axis: mm or degrees. Solid: test images; "
        "dashed, where there is such a curve: validation images, which decide. Dotted line, where "
        "there is one: the least error published.",
        "Six line charts of error against threshold.",
        11,
    ),
}
