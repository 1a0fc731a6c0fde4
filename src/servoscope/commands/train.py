"""``servoscope train``."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import UseAppendAction, arg

from servoscope.commands.options import (
    DataSet,
    Dofs,
    Force,
    Jobs,
    Json,
    Memory,
    ModelOut,
    owning_model,
    with_dofs,
)
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.storage.sizes import DEFAULT_MEMORY
from servoscope.wording import one_line

if TYPE_CHECKING:
    from servoscope.data.images import PoseImageSet
    from servoscope.pipeline import PosePipeline
    from servoscope.positioning.calibration import Calibration
    from servoscope.positioning.training import Assessed

Intrinsics = Annotated[
    str | None,
    arg(
        metavar="FX,FY,CX,CY[,K1,K2]",
        help="Of the camera, in pixels of the data set's images, as OpenCV counts them; a keyframe "
        "then does not look for them. Give them only if they are sure.",
    ),
]
PoseNoise = Annotated[
    str | None,
    arg(
        metavar="MM,DEG",
        help="Standard deviation of the reported poses; by default 0.3 mm and 0.03 deg, and 2 mm "
        "and 0.17 deg for a sequence.",
    ),
]


Add = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        metavar="DATASET",
        help="Another data set about the same reference pose or image, as of another lamp or of "
        "more images, to train on as well; may be given again.",
    ),
]


_KEPT = ("unit", "forecast_rms", "interval", "reached_rms", "one_look", "loop", "view_limit")


@owning_model
def train(
    dataset: DataSet,
    out: ModelOut = Path("servoscope-model"),
    add: Add = (),
    assessment: Path | None = None,
    method: Literal["auto", "keyframe", "features"] = "auto",
    families: str | None = None,
    regressor: str | None = None,
    intrinsics: Intrinsics = None,
    pose_noise: PoseNoise = None,
    distance_mm: float | None = None,
    dofs: Dofs = None,
    seed: int = 0,
    jobs: Jobs = None,
    memory: Memory = DEFAULT_MEMORY,
    force: Force = False,
    json: Json = False,
) -> None:
    """Train a model that brings the camera back to the reference of a data set.

    Twenty to sixty images spread over the range make a keyframe: the reference image with lens,
    mount and depth. Where none explains the view, or where families of features are named, a
    pipeline of features and a regressor for each dof is trained, on 60 images or more. The poses
    may be those of the robot's flange: where the camera sits in it need not be known. The model
    reads and commands the degrees of freedom that move in the data set, or those of --dofs.

    Example: servoscope acquire cell --schedule 40@1.6 && servoscope train cell --out model

    Example: servoscope acquire gantry --dofs tx,ty,rz --schedule 40@1.6 && servoscope train gantry

    Example: servoscope train monday --add tuesday --add other-lamp --out model

    Example: servoscope assess desk --out desk-run && servoscope train desk --assessment desk-run

    Example: servoscope train cell --intrinsics 512,512,319.5,239.5,-0.1,0.02 --pose-noise 0.1,0.02

    Example: servoscope train cell --families moments,log_polar --regressor kernel_ridge

    Args:
        assessment: Run of assess on this data set: accuracy is measured on the images that it
            tested on, and the model keeps its forecasts. If no keyframe explained the view there,
            the model is the pipeline that was assessed.
        method: What to make; by default a keyframe, or a model of features where that is not
            possible or features are named.
        families: Families of features to choose from, with commas between them, as of assess.
        regressor: What is trained on features, as of assess; a Gaussian process by default.
        distance_mm: Of the part from the camera, within a factor of two, for a keyframe.
        seed: Seed of what is held out and of the regressors, for a model of features.
    """
    from servoscope.commands.accuracy import print_accuracy
    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import console, print_json, progress_bar
    from servoscope.data.checks import check_data
    from servoscope.data.images import PoseImageSet
    from servoscope.data.independence import mark_sequence
    from servoscope.data.splits import MOST_IMAGES
    from servoscope.features.catalogue import parse_families
    from servoscope.poses import DISPLAY_FACTORS, DOFS
    from servoscope.positioning.keyframe_model import KeyframeModel
    from servoscope.positioning.training import N_STAGES
    from servoscope.positioning.training import train as train_model
    from servoscope.storage.model_folder import check_free

    processes = n_jobs(jobs)
    if assessment is not None and add:
        raise InvalidInputError(
            "--assessment is of one data set, so it does not go with --add; join the data sets in "
            "a folder (PoseImageSet.append) and assess that."
        )
    check_free(out, force=force)
    data, *others = (
        PoseImageSet.load(folder, memory=memory).thinned(MOST_IMAGES, memory)
        for folder in [dataset, *add]
    )
    for more in others:
        data = data + more
    data = with_dofs(data, dofs)
    for finding in check_data(data):
        warnings.warn(finding.text, ServoscopeWarning, stacklevel=2)
    calibration = _calibration(data.image_shape, intrinsics, pose_noise, distance_mm)
    assessed = None
    if assessment is not None:
        data = mark_sequence(data)
        assessed = read_assessment(assessment, data)
        data = _as_assessed(data, assessed, assessment, is_asked=dofs is not None)
    with progress_bar("training", N_STAGES) as advance:
        model = train_model(
            data,
            method=method,
            families=None if families is None else parse_families(families),
            regressor=regressor,
            seed=seed,
            n_jobs=processes,
            on_progress=advance,
            calibration=calibration,
            assessment=assessed,
        )
    model.save(out, force=force)
    if json:
        print_json({"model": str(out), "dofs": list(data.dofs), "accuracy": model.accuracy})
    else:
        limit = None
        if isinstance(model, KeyframeModel):
            std = (model.keyframe.limit().std * DISPLAY_FACTORS).tolist()
            limit = dict(zip(DOFS, std, strict=True))
        print_accuracy(model.accuracy, limit=limit)
        console().print(f"model: {out}", soft_wrap=True)


def read_assessment(run: Path, data: PoseImageSet) -> Assessed:
    """What a model of a data set takes from a finished run of ``assess`` on it, whose choice was
    saved.
    """
    import numpy as np

    from servoscope.errors import RunFolderError
    from servoscope.pipeline import PosePipeline
    from servoscope.positioning.training import Assessed
    from servoscope.storage.model_folder import is_model
    from servoscope.storage.run_folder import read_json, read_settings

    if read_settings(run).get("command") != "assess" or not (run / "assessment.json").exists():
        raise RunFolderError(
            f"{run} is not a finished run of assess; make one: servoscope assess DATASET --out RUN."
        )
    if not is_model(run / "models" / "pipeline"):
        raise RunFolderError(
            f"{run} holds no models/pipeline, as nothing was chosen there or it could not be saved;"
            " train without --assessment."
        )
    pipeline = PosePipeline.load(run / "models" / "pipeline")
    found = read_json(run / "assessment.json")
    own, known = data.fingerprint(), pipeline.record_.get("fingerprint")
    if known != own:
        raise InvalidInputError(
            f"{run} is an assessment of another data set (fingerprint {known}, that of this one is "
            f"{own}); assess this one, or train without --assessment."
        )
    try:
        groups = np.array(pipeline.record_["groups"], dtype=np.intp)
        record = {"fingerprint": own, "loop": found["loop"], "dofs": _dof_records(pipeline, found)}
    except (LookupError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"{run} is damaged ({one_line(error)}); make the run again with --force."
        ) from error
    return Assessed(pipeline, groups, record)


def _as_assessed(
    data: PoseImageSet, assessed: Assessed, run: Path, *, is_asked: bool
) -> PoseImageSet:
    """The data set with the dofs that were assessed."""
    dofs = tuple(assessed.pipeline.regressors_)
    if is_asked and data.dofs != dofs:
        raise InvalidInputError(
            f"{run} is an assessment of {', '.join(dofs)}, but --dofs asks for "
            f"{', '.join(data.dofs)}; assess with the same --dofs, or leave it out."
        )
    return replace(data, asked_dofs=dofs)


def _dof_records(pipeline: PosePipeline, found: dict[str, Any]) -> dict[str, Any]:
    """By dof that moves, its recipe and what was forecast and measured."""
    return {
        dof: {
            "recipe": described["recipe"],
            **{name: found["dofs"][dof][name] for name in _KEPT},
        }
        for dof, described in pipeline.describe()["dofs"].items()
    }


def _calibration(
    image_shape: tuple[int, int],
    intrinsics: str | None,
    pose_noise: str | None,
    distance_mm: float | None,
) -> Calibration:
    from servoscope.positioning.calibration import (
        Calibration,
        parse_intrinsics,
        parse_pose_noise,
    )

    if distance_mm is not None and not 1 <= distance_mm <= 1e5:
        raise InvalidInputError(f"--distance-mm must be from 1 to 100000, got {distance_mm:g}.")
    return Calibration(
        None if intrinsics is None else parse_intrinsics(intrinsics, image_shape),
        None if pose_noise is None else parse_pose_noise(pose_noise),
        None if distance_mm is None else distance_mm / 1e3,
    )
