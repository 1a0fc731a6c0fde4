"""``servoscope train``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from servoscope.commands.options import DataSet, Force, Jobs, Json, ModelOut, owning_model


@owning_model
def train(
    dataset: DataSet,
    out: ModelOut = Path("servoscope-model"),
    method: Literal["auto", "keyframe", "levels"] = "auto",
    seed: int = 0,
    jobs: Jobs = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Train a model that brings the camera back to the reference of a data set.

    Twenty to sixty images spread over the range make a keyframe: the reference image with lens,
    mount and depth. Hundreds in rings around the reference make levels and networks. The poses may
    be those of the robot's flange: where the camera sits in it need not be known.

    Example: servoscope acquire cell --schedule 40@1.6 && servoscope train cell --out model

    Args:
        method: What to make; by default levels if the images are enough for them, else a keyframe.
        seed: Seed of the nets, of what is held out, and of the disturbances.
    """
    from servoscope.commands.accuracy import print_accuracy
    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import console, print_json
    from servoscope.commands.progress import progress_bar
    from servoscope.dataset import PoseImageSet
    from servoscope.positioning.model_folder import check_free
    from servoscope.positioning.training import N_STAGES
    from servoscope.positioning.training import train as train_model

    processes = n_jobs(jobs)
    check_free(out, force=force)
    data = PoseImageSet.load(dataset)
    with progress_bar("training", N_STAGES) as advance:
        model = train_model(data, method=method, seed=seed, n_jobs=processes, on_progress=advance)
    model.save(out, force=force)
    if json:
        print_json({"model": str(out), "accuracy": model.accuracy})
    else:
        print_accuracy(model.accuracy)
        console().print(f"model: {out}", soft_wrap=True)
