"""``servoscope acquire``."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import create_mutex_group

from servoscope.commands.options import DataSetOut, Dofs, Force, Jobs, Json, Part, RobotName

IMAGES_OR_RINGS = create_mutex_group(required=False)
"""A schedule says how many images to take, so only one of the two can be asked for."""


def acquire(
    out: DataSetOut,
    n_images: Annotated[int | None, IMAGES_OR_RINGS] = None,
    schedule: Annotated[str | None, IMAGES_OR_RINGS] = None,
    until: str | None = None,
    image_size: int = 256,
    seed: int = 0,
    part: Part = "cylinder_head",
    variant: int = 0,
    robot: RobotName = "free",
    dofs: Dofs = None,
    translation_mm: float = 25.0,
    rotation_deg: float = 15.0,
    pivot_mm: float = 550.0,
    repeatability_mm: float = 0.05,
    repeatability_deg: float = 0.01,
    jobs: Jobs = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Take images of a simulated part at random poses around the reference.

    The reference looks straight down on the part from 550 mm. An interrupted acquisition goes on
    where it stopped when the same command is given again.

    Example: servoscope acquire head --n-images 1000 --image-size 256 --seed 0

    Example: servoscope acquire cell --until t=0.1mm,r=0.02deg

    Example: servoscope acquire rings --schedule 1000@1.0,400@0.2,400@0.03

    Example: servoscope acquire gantry --schedule 40@1.6 --dofs tx,ty,rz

    Example: servoscope acquire plane --schedule 40@1.6 --part textured_plane --robot arm

    Args:
        n_images: Number of images, drawn from the whole range; 1000 by default. With --until,
            the most that are taken; 100 by default.
        schedule: Rings to take instead, IMAGES@FACTOR each, FACTOR being the share of the range
            that a ring is drawn from; "default" takes those recommended for positioning.
        until: Largest median error of one look from anywhere in the range. Images are taken where
            most is learned of the view, until the forecast meets it.
        image_size: Height and width of the images, in pixels.
        seed: Seed of the poses and of the noise.
        variant: Another number, from 0, gives another part of the kind.
        translation_mm: Largest displacement along each axis, in mm.
        rotation_deg: Largest rotation about each axis, in degrees.
        pivot_mm: Distance of the centre of rotation from the camera, in mm.
        repeatability_mm: Standard deviation of the robot's position error, in mm.
        repeatability_deg: Standard deviation of the robot's rotation error, in degrees.
    """
    from servoscope.acquisition import AcquisitionConfig
    from servoscope.acquisition import acquire as acquire_images
    from servoscope.acquisition.until import FIRST, MOST_IMAGES, acquire_until
    from servoscope.commands.info import describe_data_set
    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_facts, print_message, progress_bar
    from servoscope.data.schedule import parse_schedule
    from servoscope.dofs import parse_accuracy, parse_dofs
    from servoscope.errors import InvalidInputError
    from servoscope.poses import DOFS

    request = None if until is None else parse_accuracy(until)
    if request is not None:
        if schedule is not None:
            raise InvalidInputError("--until finds out which images to take; leave --schedule out.")
        n_images = MOST_IMAGES if n_images is None else n_images
        if n_images < FIRST:
            raise InvalidInputError(
                f"--until needs at least {FIRST} images, got --n-images {n_images}."
            )
    config = AcquisitionConfig(
        n_images=n_images,
        image_size=image_size,
        seed=seed,
        translation_mm=translation_mm,
        rotation_deg=rotation_deg,
        pivot_mm=pivot_mm,
        repeatability_mm=repeatability_mm,
        repeatability_deg=repeatability_deg,
        schedule=() if schedule is None else parse_schedule(schedule),
        part=part,
        variant=variant,
        robot=robot,
        dofs=DOFS if dofs is None else parse_dofs(dofs),
    )
    with progress_bar("images", config.total()) as advance:
        if request is None:
            acquire_images(out, config, n_jobs=n_jobs(jobs), force=force, on_progress=advance)
        else:
            acquire_until(
                out, config, request, n_jobs=n_jobs(jobs), force=force, on_progress=advance,
                on_standing=lambda standing: print_message(str(standing)),
            )  # fmt: skip
    print_facts(describe_data_set(out), as_json=json)
