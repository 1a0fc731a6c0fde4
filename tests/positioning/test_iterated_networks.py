"""The networks alone, iterated: they arrive, ring by ring."""

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE, Cell
from servoscope.data.images import PoseImageSet
from servoscope.data.schedule import Ring, format_schedule
from servoscope.errors import InvalidInputError
from servoscope.poses import displacements_from_poses, poses_from_displacements
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.iterated_networks import IteratedNetworks
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.settings import LoopSettings

SCHEDULE = (Ring(600, 1.0), Ring(300, 0.4), Ring(200, 0.15))


def ring_data(schedule: tuple[Ring, ...], source: dict[str, object]) -> PoseImageSet:
    rng = np.random.default_rng(0)
    delta_p = np.concatenate([rng.uniform(-f, f, (n, 6)) * RANGES for n, f in schedule])
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), SIZE, seed=3)
    return PoseImageSet(
        images[:-1],
        poses_from_displacements(np.eye(4), delta_p, PIVOT),
        np.eye(4),
        images[-1],
        pivot=PIVOT,
        pivot_ranges=RANGES * max(f for _, f in schedule),
        source=source,
    )


@pytest.fixture(scope="module")
def networks() -> IteratedNetworks:
    told = {"rings": format_schedule(SCHEDULE)}
    return IteratedNetworks.train(ring_data(SCHEDULE, told), n_jobs=1)


def seen_at(delta_p: np.ndarray) -> np.ndarray:
    return planar_images(np.atleast_2d(delta_p), SIZE, seed=3)[0]


def test_there_is_one_set_of_networks_a_ring(networks) -> None:
    np.testing.assert_allclose(
        [ring.ranges for ring in networks.rings], [f * RANGES for _, f in SCHEDULE]
    )
    np.testing.assert_array_equal(networks.reach, RANGES)
    assert networks.image_shape == (SIZE, SIZE)


def test_it_brings_the_camera_nearer_ring_by_ring(networks) -> None:
    for start in ([0.6, -0.5, 0.3, -0.4, 0.5, 0.7], [-0.5, 0.2, 0.6, 0.4, -0.4, 0.7]):
        cell = Cell(np.array(start) * RANGES)
        result = Positioner(networks, LoopSettings(max_moves=8)).run(cell, cell)
        assert (np.abs(cell.delta_p / RANGES) < 0.15).all(), result.message
        stages = [step.estimate.stage for step in result.steps]
        assert stages == sorted(stages)
        assert stages[0] == "ring 0"
        assert stages[-1] == "ring 2"


@pytest.mark.parametrize(("factor", "stage"), [(0.8, "ring 0"), (0.2, "ring 1"), (0.01, "ring 2")])
def test_the_smallest_ring_that_holds_it_answers(networks, factor, stage) -> None:
    start = factor * RANGES * [1, -1, 1, -1, 1, -1]
    estimate = networks.estimate(seen_at(start), None)
    assert estimate.stage == stage
    ring = networks.rings[int(stage[-1])]
    told = displacements_from_poses(np.eye(4), estimate.displacement[None], PIVOT)[0]
    assert (np.abs(told - start) < 5 * ring.validation_rms).all()
    np.testing.assert_array_equal(estimate.std, ring.validation_rms)
    assert np.isnan(estimate.novelty)


def test_a_ring_is_left_later_than_it_is_entered(networks) -> None:
    def stage_at(share: float, before: str) -> str:
        previous = Estimate(np.eye(4), np.full(6, np.nan), np.nan, before)
        start = share * 0.4 * RANGES * [0, 0, 0, 0, 0, 1]
        return networks.estimate(seen_at(start), previous).stage

    assert stage_at(0.5, "ring 0") == stage_at(0.5, "ring 1") == "ring 1"
    assert (stage_at(1.15, "ring 0"), stage_at(1.15, "ring 1")) == ("ring 0", "ring 1")
    assert stage_at(2.2, "ring 0") == stage_at(2.2, "ring 1") == stage_at(2.2, "ring 2") == "ring 0"


def test_a_set_without_rings_is_one(plane) -> None:
    networks = IteratedNetworks.train(plane, n_jobs=1)
    assert len(networks.rings) == 1
    np.testing.assert_allclose(networks.reach, RANGES)


def test_a_ring_with_few_images_leaves_them_to_the_next(plane) -> None:
    few = ring_data((Ring(120, 1.0), Ring(30, 0.2)), {"rings": "120@1.0,30@0.2"})
    assert len(IteratedNetworks.train(few, n_jobs=1).rings) == 1


def test_too_few_images_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="need a ring of 100 images or more, got 60"):
        IteratedNetworks.train(ring_data((Ring(60, 1.0),), {}))
