"""Assessments of whole data sets: planes that can be learned, and images that cannot."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_data_set, planar_images
from servoscope.assessment import as_json, assess
from servoscope.assessment.decision import Decision
from servoscope.assessment.rendered import other_samples, sample_images
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import split_images
from servoscope.errors import InvalidInputError
from servoscope.pipeline import PosePipeline, Recipe, choose, fit_all
from servoscope.poses import DOFS, poses_from_displacements


def decide(data, tolerances=None, n_jobs=1, families=("moments",)):
    return as_json(assess(data, n_jobs=n_jobs, families=families), tolerances or {}, {})


@pytest.fixture(scope="module")
def plane():
    return planar_data_set(80, 24)


@contextmanager
def no_view():
    """No keyframe is fitted, where it is not the matter."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("servoscope.assessment.run.begin_view", lambda *_, **__: iter([(None, [])]))
        yield


@pytest.fixture
def without_view():
    with no_view():
        yield


@pytest.fixture(scope="module")
def decision():
    families = ("moments", "log_polar", "pose_covariance")
    with no_view():
        return decide(planar_data_set(160, 24), {"tx": 1e-3, "rz": 90.0}, 1, families)


@pytest.mark.slow
def test_forecasts_agree_with_what_is_reached(decision):
    for row in decision["dofs"].values():
        assert row["observable"] in ("well", "roughly")
        assert 0.5 < row["forecast_rms"] / row["reached_rms"] < 2
        low, high = row["interval"]
        assert low < row["forecast_rms"] < high
        assert row["forecast_rms"] < 0.6 * row["baseline_rms"]


@pytest.mark.slow
def test_errors_are_in_mm_and_degrees(decision):
    spread = dict(zip(DOFS, [25 / 3**0.5] * 3 + [15 / 3**0.5] * 3, strict=True))
    for dof, row in decision["dofs"].items():
        assert row["unit"] == ("mm" if dof[0] == "t" else "deg")
        assert row["baseline_rms"] == pytest.approx(spread[dof], rel=0.2)


@pytest.mark.slow
def test_tolerances_decide_what_is_advised(decision):
    rows = decision["dofs"]
    assert rows["tx"]["tolerance"] == 1e-3
    assert any("better than" in line or "bring 0.001 mm" in line for line in rows["tx"]["advice"])
    assert not rows["tx"]["met_in_one_look"]
    assert rows["rz"]["met_in_one_look"]
    assert not any("bring 90" in line for line in rows["rz"]["advice"])


@pytest.mark.usefixtures("without_view")
@pytest.mark.slow
def test_every_number_of_processes_decides_the_same(plane):
    one, two = (decide(plane, None, n, ("moments", "pose_covariance")) for n in (1, 2))
    assert one == two


@pytest.mark.parametrize("grey", [0, 77])
def test_of_images_that_do_not_change_nothing_can_be_learned(plane, grey):
    images = np.full_like(plane.images, grey)
    found = decide(replace(plane, images=images, reference_image=images[0]))
    assert found["conclusion"] == "Nothing can be learned from these images."
    for row in found["dofs"].values():
        assert row["limited_by"] == "images do not change"
        assert row["forecast_rms"] == pytest.approx(row["baseline_rms"], rel=0.02)
        assert row["observable"] == "not"
        assert row["advice"][0].startswith("nothing can be learned")


@pytest.mark.usefixtures("without_view")
@pytest.mark.slow
def test_nothing_is_learned_of_noise(plane):
    noise = np.random.default_rng(0).integers(0, 256, plane.images.shape).astype(np.uint8)
    found = decide(replace(plane, images=noise))
    assert {row["limited_by"] for row in found["dofs"].values()} == {"no feature predicts it"}
    assert found["conclusion"] == "Nothing can be learned from these images."


def test_what_never_moves_has_no_forecast(plane):
    still = np.repeat(plane.T_world_ref[None], len(plane), axis=0)
    found = decide(replace(plane, T_world_cam=still), {"tx": 1.0})
    for row in found["dofs"].values():
        assert (row["forecast_rms"], row["limited_by"]) == (None, "never moves")
    assert found["dofs"]["tx"]["tolerance"] == 1.0


@pytest.mark.parametrize("where", ["train", "test"])
@pytest.mark.usefixtures("without_view")
def test_what_moves_in_a_single_image_breaks_nothing(where):
    delta_p = np.random.default_rng(0).uniform(-1, 1, (64, 6)) * RANGES
    delta_p[:, 2:] = 0
    delta_p[getattr(split_images(64), where)[0], 5] = 0.1
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), 16, 0)
    data = PoseImageSet(
        images[:-1], poses_from_displacements(np.eye(4), delta_p, PIVOT), np.eye(4), images[-1]
    )
    row = decide(data)["dofs"]["rz"]
    assert (row["observable"] == "still") == (where == "test")


@pytest.fixture(scope="module")
def found(plane):
    """Features that are fitted to images, whose learning curve starts from another error."""
    with no_view():
        return assess(plane, n_jobs=1, families=["pose_covariance"])


def test_a_tolerance_that_twice_the_images_meet_takes_as_many_more(found):
    (n, twice, _, _) = as_json(found, {}, {})["dofs"]["rz"]["learning_curve"]["rms"]
    assert twice < 0.95 * n
    advice = as_json(found, {"rz": 1.0001 * twice}, {})["dofs"]["rz"]["advice"]
    (more,) = [line for line in advice if "more images bring" in line]
    assert int(more.split()[1]) == pytest.approx(60, rel=0.07)


def test_images_of_which_no_family_can_be_had_are_refused_in_one_line(plane):
    one = replace(plane, images=plane.images[:, :1, :1], reference_image=plane.images[0, :1, :1])
    with pytest.raises(InvalidInputError, match=r"None of the families .* 60 images of 1 x 1 px"):
        assess(one, n_jobs=1, families=["eigenfeatures"])


@pytest.mark.usefixtures("without_view")
def test_the_noise_of_encoders_is_no_motion(plane):
    frozen = np.repeat(plane.images[:1], len(plane), axis=0)
    delta_p = np.random.default_rng(0).normal(0, 1e-9, (len(plane), 6))
    delta_p[:, 0] = np.linspace(-0.02, 0.02, len(plane))
    poses = poses_from_displacements(plane.T_world_ref, delta_p, PIVOT)
    rows = decide(replace(plane, images=frozen, T_world_cam=poses))["dofs"]
    assert [dof for dof in DOFS if rows[dof]["limited_by"] != "never moves"] == ["tx"]


def stripes(delta_p, size):
    """Images of a row of dots on a plane, repeating along x and y."""
    images = planar_images(delta_p, size, seed=0).astype(float)
    tx, ty = (delta_p[:, i, None, None] for i in (0, 1))
    y, x = np.mgrid[:size, :size] / size
    waves = np.sin(40 * x - 4000 * tx) + np.sin(40 * y - 4000 * ty)
    return np.clip(120 + 0 * images + 40 * waves, 0, 255).round().astype(np.uint8)


@pytest.mark.usefixtures("without_view")
@pytest.mark.slow
def test_a_pattern_that_repeats_within_the_range_is_blamed():
    delta_p = np.random.default_rng(0).uniform(-1, 1, (80, 6)) * RANGES
    images = stripes(np.vstack([delta_p, np.zeros(6)]), 48)
    data = PoseImageSet(
        images[:-1],
        poses_from_displacements(np.eye(4), delta_p, PIVOT),
        np.eye(4),
        images[-1],
        pivot=PIVOT,
        pivot_ranges=RANGES,
    )
    found = decide(data)
    assert found["images"]["repeats"]
    for dof in ("tx", "ty"):
        assert found["dofs"][dof]["limited_by"] == "repeating pattern"
        assert "repeats every" in found["dofs"][dof]["advice"][0]
    assert any("looks like itself" in line for line in found["warnings"])


@pytest.mark.usefixtures("without_view")
@pytest.mark.slow
def test_a_sequence_is_tested_on_whole_blocks_and_says_what_a_random_split_promises():
    n = 160
    steps = np.random.default_rng(3).normal(size=(n + 20, 6))
    path = np.stack([np.convolve(s, np.hanning(21), "valid") for s in steps.T], axis=1)[:n]
    delta_p = path / np.abs(path).max(axis=0) * RANGES
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), 24, 0)
    data = PoseImageSet(
        images[:-1],
        poses_from_displacements(np.eye(4), delta_p, PIVOT),
        np.eye(4),
        images[-1],
        pivot=PIVOT,
        pivot_ranges=RANGES,
    )
    found = decide(data)
    assert found["images"]["independence"] == "sequence"
    assert (found["images"]["n_splits"], found["images"]["n_tested"]) == (4, 157)
    for row in found["dofs"].values():
        assert 0.4 < row["split_rms"] / row["reached_rms"] < 2.5
        for end in ("interval", "reached_interval"):
            low, high = row[end]
            assert high > 1.7 * low  # as even errors scatter of which five blocks tell
        assert row["interval"][0] < row["forecast_rms"] < row["interval"][1]
        assert row["reached_interval"][0] < row["reached_rms"] < row["reached_interval"][1]
    promises = [
        line
        for row in found["dofs"].values()
        for line in row["advice"]
        if "taken for independent they promise" in line
    ]
    assert promises


def test_too_few_images_are_refused_in_one_line():
    with pytest.raises(InvalidInputError, match="at least 20 images, and 60 where no keyframe"):
        assess(planar_data_set(19, 16))


def test_unknown_families_are_refused():
    with pytest.raises(InvalidInputError, match=r"taken from moments, .* got 'gabor'"):
        assess(planar_data_set(60, 16), families=["gabor"])


@pytest.fixture(scope="module")
def decided(plane):
    """What is learned from and tested in every split, of a plane with 80 images."""
    sample = sample_images(plane, n_jobs=1)
    seen = []

    def fit(table, targets, split, jobs, **options):
        seen.append((split, [recipe.name for recipe, _ in jobs]))
        return fit_all(table, targets, split, jobs, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("servoscope.assessment.decision.fit_all", fit)
        decision = Decision(sample, ("moments", "pose_covariance"), "kernel_ridge", n_jobs=1)
        return decision, decision.measure(), seen


def test_every_image_is_tested_once_by_models_that_have_not_seen_it(decided):
    decision, measured, seen = decided
    assert measured.n_splits == len(seen) == 4
    assert np.sort(measured.images).tolist() == list(range(80))
    for split, _ in seen:
        assert not set(split.test) & set(split.learned)
        assert len(split.test) + len(split.learned) == 80
    np.testing.assert_array_equal(seen[0][0].test, decision.sample.split.test)


def test_the_pooled_error_is_that_of_pipelines_fitted_to_each_split(decided, plane):
    _, measured, seen = decided
    errors = np.zeros((80, 6))
    for split, names in seen:
        recipes = [Recipe(name, regressor="kernel_ridge") for name in names]
        pipeline = PosePipeline(dict(zip(DOFS, recipes, strict=True)))
        pipeline.fit(plane.images, plane.delta_p() / plane.ranges(), split)
        predicted = pipeline.predict(plane.images[split.test])
        errors[split.test] = predicted - (plane.delta_p() / plane.ranges())[split.test]
    for dof, found in measured.errors.items():
        np.testing.assert_allclose(found, errors[measured.images, DOFS.index(dof)], atol=1e-5)
        assert measured.rms(dof) == pytest.approx(np.sqrt(np.mean(found**2)))


def test_features_are_chosen_by_the_images_that_are_not_tested(decided):
    """A family that fails on the tested images alone is chosen there all the same."""
    candidates = decided[0].candidates
    good, n = next(iter(candidates)), len(decided[0].sample.split.learned)
    tested, residuals = np.arange(10), np.full((n, 1), 0.5)
    spoilt = residuals.copy()
    spoilt[tested], spoilt[10:] = 9.0, 0.1

    def of(values):
        forecast = replace(candidates[good].forecasts["tx"], residuals=values)
        return replace(candidates[good], forecasts={"tx": forecast})

    both = {"good": of(residuals), "spoilt": of(spoilt)}
    assert choose(both) == {"tx": "good"}
    assert choose(both, np.arange(10, n)) == {"tx": "spoilt"}


def test_many_independent_images_are_tested_in_one_split():
    images = np.zeros((400, 4, 4), np.uint8)
    delta_p = np.random.default_rng(0).uniform(-1, 1, (400, 6)) * RANGES
    poses = poses_from_displacements(np.eye(4), delta_p, PIVOT)
    sample = sample_images(PoseImageSet(images, poses, np.eye(4), images[0]), n_jobs=1)
    assert list(other_samples(sample)) == []
