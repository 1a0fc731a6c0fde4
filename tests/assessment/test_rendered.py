"""Assessments of few images, which images rendered by a keyframe join."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from planar import PIVOT, RANGES, planar_data_set, planar_images
from servoscope.assessment import as_json, assess
from servoscope.assessment.rendered import _render, _spread, sample_images
from servoscope.data.independence import independent_groups, split_groups
from servoscope.errors import InvalidInputError
from servoscope.poses import poses_from_displacements
from servoscope.processes import no_progress
from servoscope.selection import forecast_errors
from small_keyframe import quick_fits

N_RENDERED = 128


@pytest.fixture(scope="module", autouse=True)
def _quick():
    with quick_fits():
        yield


@pytest.fixture(scope="module")
def few():
    return planar_data_set(24, 96)


@pytest.fixture(scope="module")
def sample(few):
    return sample_images(few, n_rendered=N_RENDERED, n_jobs=1)


def test_rendered_images_show_what_would_be_seen(sample):
    delta_p = sample.data.delta_p()[sample.n_real :]
    truth = planar_images(np.vstack([delta_p, np.zeros(6)]), 96, 0)[:-1].astype(float)
    images = sample.data.images[sample.n_real :].astype(float)
    contrast = np.abs(truth - truth.mean(axis=0)).mean()
    assert np.abs(images - truth).mean() < 0.25 * contrast


def test_only_real_images_test_and_the_keyframe_has_not_seen_them(few, sample):
    split, n_learned = sample.split, len(sample.real_split.learned)
    assert sample.n_real == len(few)
    assert (split.test < len(few)).all()
    assert sorted([*sample.view.fitted, *split.test]) == list(range(len(few)))
    assert np.array_equal(sample.view.fitted, sample.real_split.learned)
    assert np.array_equal(sample.view.read, split.test)
    assert (n_learned, len(split.learned)) == (16, 16 + N_RENDERED)
    assert list(sample.data.names[: len(few)]) == list(few.names)
    assert sample.data.names[-1] == f"rendered_{N_RENDERED - 1:04d}"
    assert np.array_equal(sample.real.images, few.images)


def test_the_range_and_what_moves_are_those_of_the_real_images(sample):
    few = planar_data_set(24, 96)
    assert np.allclose(sample.data.ranges(), few.ranges())
    assert (np.abs(sample.data.delta_p()) <= few.ranges() * (1 + 1e-9)).all()
    assert sample.data.dofs == few.dofs


def test_every_number_of_processes_renders_the_same(few, sample):
    view, delta_p = sample.view, sample.data.delta_p()[sample.n_real :][:24]
    first, second = (_render(view, few, delta_p, 0, n, no_progress) for n in (1, 2))
    assert np.array_equal(first, second)
    assert np.array_equal(first[:20], sample.data.images[sample.n_real :][:20])
    assert not np.array_equal(first, _render(view, few, delta_p, 1, 1, no_progress))


@pytest.mark.slow
def test_of_a_robot_of_three_dofs_only_those_are_rendered(sample):
    delta_p = np.random.default_rng(0).uniform(-1, 1, (24, 6)) * RANGES
    delta_p[:, 2:5] = 0
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), 96, 0)
    planar = replace(
        planar_data_set(24, 96),
        images=images[:-1],
        T_world_cam=poses_from_displacements(np.eye(4), delta_p, PIVOT),
        pivot_ranges=None,
    )
    found = sample_images(planar, seed=1, n_rendered=16, n_jobs=1)
    assert np.abs(found.data.delta_p()[:, 2:5]).max() < 1e-9
    assert found.data.dofs == ("tx", "ty", "rz")
    assert not np.intersect1d(found.split.test, sample.split.test).size


def test_enough_images_are_assessed_as_they_are():
    data = planar_data_set(60, 16)
    found = sample_images(data)
    expected = split_groups(data, independent_groups(data), 0)
    assert (found.n_rendered, found.data) == (0, data)
    assert np.array_equal(found.split.test, expected.test)


def test_images_that_no_keyframe_explains_are_refused_in_one_line(few):
    order = np.random.default_rng(0).permutation(len(few))
    shuffled = replace(few, images=few.images[order])
    with pytest.raises(InvalidInputError, match=r"at least 60 images .* got 24.* \d of 8 ") as told:
        assess(shuffled, n_jobs=1)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("n_images", [1, 19])
def test_fewer_than_twenty_images_are_refused(few, n_images):
    with pytest.raises(InvalidInputError, match=rf"20 images, and 60 .* got {n_images};"):
        assess(few[:n_images], n_jobs=1)


def test_images_of_one_pose_are_refused(few):
    still = replace(few, T_world_cam=np.repeat(np.eye(4)[None], len(few), axis=0))
    with pytest.raises(InvalidInputError, match="at least 60 images"):
        sample_images(still)


def test_dofs_that_move_together_do_so_in_what_is_rendered_and_others_do_not():
    rng = np.random.default_rng(0)
    given = rng.uniform(-1, 1, (20, 3))
    given[:, 2] = 0.5 * given[:, 0]
    drawn = _spread(given, np.array([1.0, 1.0, 0.5]), 256, rng)
    assert drawn[:, 2] == pytest.approx(0.5 * drawn[:, 0], abs=0.01)
    assert abs(spearmanr(drawn[:, 0], drawn[:, 1])[0]) < 0.1
    for shares, at in ((np.quantile(drawn, q, axis=0), q) for q in (0.25, 0.5, 0.75)):
        assert shares == pytest.approx(np.quantile(given, at, axis=0), abs=0.2)


def test_the_forecast_is_that_of_the_real_images_where_these_err_more(sample):
    rng = np.random.default_rng(0)
    y = rng.uniform(-1, 1, (len(sample.split.learned), 1))
    is_real = sample.split.learned < sample.n_real
    X = y + np.where(is_real[:, None], 0.3, 0.01) * rng.normal(size=y.shape)
    forecast = forecast_errors(X, y)
    found = sample.on_real_images(forecast)
    assert found.rms[0] > 1.5 * forecast.rms[0]
    assert found.rms[0] == pytest.approx(np.sqrt(np.mean(forecast.residuals[is_real] ** 2)))
    low, high = found.interval[:, 0]
    assert low < 0.85 * found.rms[0]
    assert high > 1.15 * found.rms[0]


@pytest.mark.slow
def test_forecasts_of_few_images_agree_with_what_other_real_images_show(few, sample, monkeypatch):
    monkeypatch.setattr("servoscope.assessment.run.sample_images", lambda *_, **__: sample)
    found = assess(few, families=["moments"], n_jobs=1)
    decision = as_json(found, {}, {})
    images = decision["images"]
    assert images["n_rendered"] == N_RENDERED
    assert (images["n_train"] + images["n_validation"], images["n_test"]) == (16, 8)
    assert images["split"]["test"] == sample.split.test.tolist()
    assert any(f"{N_RENDERED} rendered" in line for line in decision["warnings"])
    other = planar_data_set(224, 96)[24:]
    errors = found.pipeline.predict(other.images) - other.delta_p()
    measured = np.sqrt(np.mean(errors**2, axis=0)) / other.ranges()
    forecast = np.array([one.rms[0] for one in found.decision.forecasts.values()])
    assert np.abs(np.log(forecast / measured)).max() < np.log(2.5)  # of 8 images
    assert np.exp(np.mean(np.log(forecast / measured))) == pytest.approx(1, abs=0.5)
    assert found.view.n_read == 8
