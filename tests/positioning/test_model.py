"""A trained model tells where images were taken, again after it was saved, or is refused."""

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE
from planar_model import camera_model
from servoscope.errors import FolderExistsError, ModelError
from servoscope.poses import displacements_from_poses
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.model import PositioningModel
from servoscope.scene.disturbances import Disturbances
from servoscope.storage.model_folder import read_model, write_model

TOLD = ("displacement", "std", "novelty", "stage", "is_finest", "level")


@pytest.fixture(scope="module")
def model() -> PositioningModel:
    return camera_model()


@pytest.fixture
def folder(model, tmp_path):
    model.save(tmp_path / "model")
    return tmp_path / "model"


def images_at(share: float, n: int = 12, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Images that no model was trained on, and their displacements about the pivot."""
    delta_p = share * np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES
    return planar_images(delta_p, SIZE, seed=3), delta_p


def errors(model: PositioningModel, images: np.ndarray, delta_p: np.ndarray) -> np.ndarray:
    """Absolute errors in shares of the reach."""
    said = np.stack([model.estimate(image).displacement for image in images])
    return np.abs(displacements_from_poses(np.eye(4), said, PIVOT) - delta_p) / RANGES


def assert_same(a, b) -> None:
    for name in TOLD:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_nearer_images_are_told_by_narrower_levels_and_more_exactly(model) -> None:
    far, middle, near = (np.median(errors(model, *images_at(s))) for s in (1.0, 0.2, 0.02))
    assert far < 0.15
    assert middle < 0.2 * far
    assert near < 0.01
    levels = [[model.estimate(i).level for i in images_at(s)[0]] for s in (1.0, 0.2, 0.02)]
    assert np.median(levels[0]) < np.median(levels[1]) < np.median(levels[2])
    assert set(levels[2]) == {len(model.levels) - 1}
    assert model.estimate(images_at(0.02)[0][0]).is_finest


def test_a_saved_model_tells_the_same_to_the_last_bit(model, folder) -> None:
    again = PositioningModel.load(folder)
    for share in (1.0, 0.2, 0.02):
        for image in images_at(share, 4)[0]:
            first = model.estimate(image)
            assert_same(again.estimate(image), first)
            assert_same(again.estimate(image, first), model.estimate(image, first))
    assert again.image_shape == model.image_shape == (SIZE, SIZE)
    assert again.pivot == model.pivot
    assert again.trained_on == {"part": "plane"}
    assert again.accuracy == model.accuracy
    np.testing.assert_array_equal(again.reach, model.reach)
    np.testing.assert_array_equal(again.reference_image, model.reference_image)


def test_a_model_that_was_loaded_is_saved_as_the_same_bytes(folder, tmp_path) -> None:
    PositioningModel.load(folder).save(tmp_path / "again")
    for part in folder.iterdir():
        assert (tmp_path / "again" / part.name).read_bytes() == part.read_bytes()


def test_a_model_is_replaced_by_force_only(model, folder) -> None:
    with pytest.raises(FolderExistsError, match="holds a model already"):
        model.save(folder)
    model.save(folder, force=True)


def change(**changes):
    """Change the header."""
    return lambda header, arrays: header.update(changes)


def change_level(**changes):
    """Change what the header says of the widest level."""
    return lambda header, arrays: header["levels"][0].update(changes)


def drop(name):
    """Leave an array out."""
    return lambda header, arrays: arrays.pop(name)


def replace_array(name, function):
    """Change an array."""
    return lambda header, arrays: arrays.update({name: function(arrays[name])})


def only_of_another_kind(header, arrays) -> None:
    header.clear()
    header["weights"] = "of something else"


@pytest.mark.parametrize(
    "tamper",
    [
        only_of_another_kind,
        drop("level0/coefficients"),
        drop("level1/precision"),
        drop("reference_image"),
        replace_array("level0/coefficients", lambda a: a[:, 1:]),
        replace_array("level0/coefficients", lambda a: a[1:]),
        replace_array("level0/coefficients", np.ravel),
        replace_array("level0/precision", lambda a: a[1:]),
        replace_array("level0/precision", lambda a: -a),
        replace_array("reference_image", lambda a: a[1:]),
        replace_array("reference_image", lambda a: a.astype(float)),
        replace_array("reference_image", lambda a: a[None]),
        change(image_size=[SIZE, SIZE + 1]),
        change(image_size=None),
        change(image_size=[1, SIZE, SIZE]),
        change(reach=[0.1] * 5),
        change(reach=[0.1] * 5 + [None]),
        change(reach=[0.1] * 5 + [-0.1]),
        change(reach=[0.1] * 5 + [[0.1]]),
        change(reach="far"),
        change(pivot=None),
        change(pivot="near"),
        change(levels=[]),
        change(levels=None),
        change(levels=[None]),
        change(levels={"a": 1}),
        change(trained_on=None),
        change(accuracy=3),
        change(networks=None),
        change(networks=[1]),
        change(networks={}),
        change_level(degree=2),
        change_level(degree=1000),
        change_level(degree=-1),
        change_level(degree=None),
        change_level(shape=[24]),
        change_level(shape=[12, 48]),
        change_level(shape=[-24, -24]),
        change_level(radius=0),
        change_level(radius=-1.0),
        change_level(radius=None),
        change_level(blur=0),
        change_level(blur=0.2),
        change_level(high_pass=-1),
        change_level(std_factor=-1),
        change_level(unlikeness_limit=0),
        change_level(unlikeness_limit="much"),
    ],
)
def test_models_that_do_not_hold_together_are_refused_in_a_line(folder, tmp_path, tamper) -> None:
    header, arrays = read_model(folder)
    tamper(header, arrays)
    write_model(tmp_path / "tampered", header, arrays)
    with pytest.raises(ModelError, match="is not a model for positioning") as info:
        PositioningModel.load(tmp_path / "tampered")
    assert "\n" not in str(info.value)
    assert len(str(info.value)) < 600


def test_a_damaged_model_is_refused(folder) -> None:
    (folder / "arrays.npz").write_bytes((folder / "arrays.npz").read_bytes()[:-100])
    with pytest.raises(ModelError, match=r"arrays\.npz cannot be read"):
        PositioningModel.load(folder)


def test_the_level_that_answered_before_begins(model, monkeypatch) -> None:
    image = images_at(0.02, 1)[0][0]
    previous = model.estimate(image)
    asked = watch_levels(model, monkeypatch)
    again = model.estimate(image, previous)
    assert asked == [previous.level]
    assert again.level == previous.level
    error = again.displacement - previous.displacement
    assert np.abs(error).max() < 1e-3


def test_where_the_level_before_is_not_content_the_widest_begins(model, monkeypatch) -> None:
    near, far = images_at(0.02, 1)[0][0], images_at(0.9, 1)[0][0]
    previous, first = model.estimate(near), model.estimate(far)
    asked = watch_levels(model, monkeypatch)
    assert_same(model.estimate(far, previous), first)
    assert asked[:2] == [previous.level, 0]


def test_estimates_of_others_are_no_hint(model) -> None:
    image = images_at(0.1, 1)[0][0]
    first = model.estimate(image)
    other = Estimate(np.eye(4), np.zeros(6), 0.0, "oracle")
    assert_same(model.estimate(image, other), first)


def watch_levels(model, monkeypatch) -> list[int]:
    """The numbers of the levels that are asked from now on."""
    asked: list[int] = []
    numbers = {id(level): number for number, level in enumerate(model.levels)}
    kind = type(model.levels[0])
    align = kind.align

    def watched(level, *args, **options):
        asked.append(numbers[id(level)])
        return align(level, *args, **options)

    monkeypatch.setattr(kind, "align", watched)
    return asked


@pytest.mark.parametrize("share", [1.0, 0.2, 0.02])
def test_images_of_the_part_are_not_novel(model, share) -> None:
    novelty = [model.estimate(image).novelty for image in images_at(share, 20)[0]]
    assert max(novelty) < 1


@pytest.mark.parametrize(
    "disturbances",
    [
        Disturbances.only(gain=0.8),
        Disturbances.only(covering=0.1),
        Disturbances.only(noise=10),
    ],
    ids=["gain", "covering", "noise"],
)
@pytest.mark.parametrize("share", [1.0, 0.2])
def test_disturbed_images_of_the_part_are_not_novel(model, share, disturbances, rng) -> None:
    images, _ = images_at(share, 20)
    novelty = [model.estimate(disturbances.disturb(i, rng)).novelty for i in images]
    assert np.mean(np.array(novelty) < 1) >= 0.95


@pytest.mark.parametrize("seed", range(4, 10))
def test_images_of_another_texture_are_novel(model, seed) -> None:
    delta_p = 0.5 * np.random.default_rng(seed).uniform(-1, 1, (10, 6)) * RANGES
    images = planar_images(delta_p, SIZE, seed=seed)
    assert np.mean([model.estimate(image).novelty > 1 for image in images]) >= 0.9


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((SIZE, SIZE)),
        np.full((SIZE, SIZE), 255),
        np.random.default_rng(0).integers(0, 256, (SIZE, SIZE)),
        np.indices((SIZE, SIZE)).sum(axis=0) % 2 * 255,
    ],
    ids=["black", "white", "noise", "checks"],
)
def test_images_of_nothing_are_novel_and_give_finite_displacements(model, image) -> None:
    estimate = model.estimate(image.astype(np.uint8))
    assert np.isfinite(estimate.displacement).all()
    assert estimate.novelty > 1
