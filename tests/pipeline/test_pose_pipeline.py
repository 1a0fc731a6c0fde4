"""Pipelines from images to displacements."""

import json

import numpy as np
import pytest
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.linear_model import Ridge

from planar import planar_data_set
from servoscope.data.splits import Split, split_images
from servoscope.errors import InvalidInputError, ModelError, PluginError
from servoscope.pipeline import FeatureTable, PosePipeline, Recipe, fit_all
from servoscope.poses import DOFS
from servoscope.storage.model_folder import read_model, write_model

RECIPES = dict.fromkeys(DOFS, Recipe("moments+eigenfeatures")) | {
    "tx": Recipe("moments", ("x_*", "m00_*"), "levenberg_marquardt", {"hidden": 3, "restarts": 1}),
    "rz": Recipe("pose_covariance+least_squares", regressor="kernel_ridge"),
}
SPLIT = split_images(120)


@pytest.fixture(scope="module")
def plane():
    return planar_data_set(120, 24)


@pytest.fixture(scope="module")
def fitted(plane) -> PosePipeline:
    return PosePipeline(RECIPES).fit(plane.images, plane.delta_p(), SPLIT)


def test_it_predicts_displacements_that_it_has_not_seen(plane, fitted):
    test = SPLIT.test
    predicted, std = fitted.predict(plane.images[test], return_std=True)
    errors = predicted - plane.delta_p()[test]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert (rms < 0.85 * plane.delta_p().std(axis=0)).all()
    measured = [fitted.record_["measured"][dof] for dof in DOFS]
    np.testing.assert_allclose(rms, measured, rtol=1e-5)
    assert 0.7 < np.mean(np.abs(errors) < 1.96 * std) <= 1


def test_it_is_a_scikit_learn_estimator(plane, fitted):
    copy = clone(fitted)
    assert copy.get_params()["recipes"] == RECIPES
    assert not hasattr(copy, "regressors_")
    copy.set_params(dofs=("tx", "rz"), recipes=Recipe("moments", regressor="kernel_ridge"))
    copy.fit(plane.images, plane.delta_p()[:, [0, 5]])
    assert copy.predict(plane.images[:3]).shape == (3, 2)
    assert copy.score(plane.images, plane.delta_p()[:, [0, 5]]) > 0.5


def test_every_number_of_processes_gives_the_same_bits(plane, fitted):
    again = PosePipeline(RECIPES, n_jobs=2).fit(plane.images, plane.delta_p(), SPLIT)
    for one, other in zip(
        fitted.predict(plane.images[:9], return_std=True),
        again.predict(plane.images[:9], return_std=True),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


def test_what_is_saved_predicts_the_same(plane, fitted, tmp_path):
    fitted.save(tmp_path / "pipeline")
    loaded = PosePipeline.load(tmp_path / "pipeline")
    np.testing.assert_array_equal(
        loaded.predict(plane.images[:9], return_std=True),
        fitted.predict(plane.images[:9], return_std=True),
    )
    assert loaded.describe() == fitted.describe() == json.loads(json.dumps(fitted.describe()))
    np.testing.assert_array_equal(loaded.split_.test, SPLIT.test)


def test_a_description_names_recipe_and_features(fitted):
    told = fitted.describe()["dofs"]["tx"]
    assert told["recipe"]["regressor"] == "levenberg_marquardt"
    assert told["features"] == [f"x_{s}" for s in (50, 100, 150)] + [
        f"m00_{s}" for s in (50, 100, 150)
    ]


@pytest.mark.parametrize(
    "change",
    [
        {"dofs.tx.columns": np.array([0, 1, 2, 3, 4, 9999])},
        {"dofs.tx.columns": np.arange(6)},
        {"features.eigenfeatures.mean": np.zeros(7)},
        {"ranges": np.ones(6)},
        {"sample": np.zeros((24, 24), np.uint8)},
        {"sample": np.zeros(5, np.uint8)},
        {"header": np.frombuffer(b"[]", np.uint8)},
    ],
)
def test_arrays_that_do_not_belong_together_are_refused_in_one_line(fitted, tmp_path, change):
    fitted.save(tmp_path / "pipeline")
    header, arrays = read_model(tmp_path / "pipeline")
    write_model(tmp_path / "pipeline", header, arrays | change, force=True)
    with pytest.raises(ModelError) as raised:
        PosePipeline.load(tmp_path / "pipeline")
    assert "\n" not in str(raised.value)


def test_a_model_of_another_kind_is_refused(tmp_path):
    write_model(tmp_path / "other", {"kind": "keyframe"}, {})
    with pytest.raises(ModelError, match="another kind than a pose pipeline"):
        PosePipeline.load(tmp_path / "other")


class Rows:
    """Means of the rows of images."""

    is_learned = False

    def fit(self, images, displacements):
        return self

    def transform(self, images):
        return np.asarray(images, dtype=float).mean(axis=2)


class Slope(RegressorMixin, BaseEstimator):
    """Tells no standard deviation."""

    def fit(self, X, y):
        self.ridge_ = Ridge(1e-3).fit(X, y)
        return self

    def predict(self, X):
        return self.ridge_.predict(X)


def test_own_features_and_regressors_go_in_as_objects(plane, tmp_path):
    pipeline = PosePipeline(Recipe(Rows(), regressor=Slope()), n_jobs=2)
    pipeline.fit(plane.images, plane.delta_p(), SPLIT)
    predicted, std = pipeline.predict(plane.images[SPLIT.test], return_std=True)
    error = predicted - plane.delta_p()[SPLIT.test]
    rows, Y = plane.images.mean(axis=2), plane.delta_p()
    learned = np.concatenate([SPLIT.train, SPLIT.validation])
    alone = Slope().fit(rows[learned], Y[learned, 0] / np.abs(Y[learned, 0]).max())
    expected = alone.predict(rows[SPLIT.test]) * np.abs(Y[learned, 0]).max() - Y[SPLIT.test, 0]
    np.testing.assert_allclose(error[:, 0], expected, atol=1e-9)
    assert (std > 0).all()
    with pytest.raises(InvalidInputError, match="saved with names, but its features are a Rows"):
        pipeline.save(tmp_path / "pipeline")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (lambda n: np.zeros(n), r"must be one row an image, \(1, n_features\), got \(1,\)"),
        (lambda n: np.full((n, 2), np.nan), "hold NaN or infinity"),
        (lambda n: np.full((n, 2), "a"), "are no numbers"),
        (lambda n: [][n], r"'Odd' failed \(IndexError: list index out of range"),
    ],
)
def test_features_that_are_no_table_of_numbers_are_refused(plane, values, said):
    class Odd(Rows):
        def transform(self, images):
            return values(len(images))

    with pytest.raises(PluginError, match=said):
        FeatureTable.fit(plane.images, plane.delta_p(), [Odd()], n_jobs=1)


def test_groups_decide_as_a_whole_and_are_divided_by_no_split(plane):
    groups = np.arange(120) // 10
    pipeline = PosePipeline(Recipe(regressor="kernel_ridge")).fit(
        plane.images, plane.delta_p(), groups=groups
    )
    split = pipeline.split_
    assert not set(groups[split.train]) & set(groups[split.validation])
    assert len(split.train) + len(split.validation) == 120
    with pytest.raises(InvalidInputError, match="in two parts of the split"):
        PosePipeline().fit(plane.images, plane.delta_p(), SPLIT, groups)


@pytest.mark.parametrize(
    ("recipes", "said"),
    [
        (Recipe("gabor"), "taken from moments"),
        (Recipe(regressor="magic"), "no regressor named 'magic'"),
        (Recipe(columns=("w_1",)), "The recipe takes w_1 of moments"),
        ({"tx": Recipe()}, "recipes must be of tx, ty"),
    ],
)
def test_a_wrong_recipe_is_refused(plane, recipes, said):
    with pytest.raises(InvalidInputError, match=said):
        PosePipeline(recipes).fit(plane.images, plane.delta_p())


def test_images_of_another_size_are_refused(fitted):
    with pytest.raises(InvalidInputError, match=r"24 x 24 px .* got 24 x 25"):
        fitted.predict(np.zeros((2, 24, 25), np.uint8))
    with pytest.raises(InvalidInputError, match=r"shape \(n, height, width\)"):
        fitted.predict(np.zeros((24, 24), np.uint8))


def test_a_job_does_not_depend_on_its_place_in_the_list(plane):
    X = np.random.default_rng(0).normal(size=(60, 4))
    table = FeatureTable(X, ("a", "b", "c", "d"), ("own",) * 4)
    net = Recipe("own", regressor="levenberg_marquardt", settings={"hidden": 2, "restarts": 1})
    split = Split(np.arange(30), np.arange(30, 45), np.arange(45, 60))
    jobs = [(net, dof) for dof in ("a", "b")]
    one, two = (
        fit_all(table, np.tanh(X[:, :2]), split, order, dofs=("a", "b"), n_jobs=1)
        for order in (jobs, jobs[::-1])
    )
    np.testing.assert_array_equal(one[0].errors, two[1].errors)
    other = fit_all(table, np.tanh(X[:, :2]), split, jobs, dofs=("a", "b"), seed=1, n_jobs=1)
    assert not np.array_equal(one[0].errors, other[0].errors)


def test_folds_of_learned_projections_are_those_fitted_anew(plane):
    names, learn = ["moments", "eigenfeatures", "pose_covariance"], np.arange(90)
    Y = plane.delta_p() / plane.ranges()
    table = FeatureTable.fit(plane.images, Y, names, learn, n_folds=3, n_jobs=1)
    for fold in table.folds:
        used = np.setdiff1d(learn, fold.left_out)
        anew = FeatureTable.fit(plane.images, Y, names, used, n_jobs=1)
        folded = fold.X[:, [table.names.index(name) for name in anew.names]]
        np.testing.assert_allclose(np.abs(folded), np.abs(anew.values[learn]), rtol=1e-2, atol=1e-4)


def test_folds_have_the_columns_of_the_table_however_few_the_images(plane):
    """Of 90 images there are 30 eigenfeatures, of the 60 that a fold learns from there were 20."""
    names, learn = ["eigenfeatures", "moments", "least_squares"], np.arange(90)
    Y = plane.delta_p() / plane.ranges()
    table = FeatureTable.fit(plane.images, Y, names, learn, n_folds=3, n_jobs=1)
    moments = table.columns(Recipe("moments"))
    for fold in table.folds:
        assert fold.X.shape[1] == len(table.names)
        np.testing.assert_array_equal(fold.X[:, moments], table.values[np.ix_(learn, moments)])


def test_what_a_table_has_of_the_same_images_is_not_computed_again(plane, monkeypatch):
    names, Y = ["moments", "pose_covariance"], plane.delta_p() / plane.ranges()
    learn, other = np.arange(90), np.arange(30, 120)
    table = FeatureTable.fit(plane.images, Y, names, learn, n_jobs=1)
    anew = FeatureTable.fit(plane.images, Y, names, other, n_jobs=1)
    same = FeatureTable.fit(plane.images, Y, names, other, known=table, n_jobs=1)
    np.testing.assert_array_equal(same.values, anew.values)
    assert same.names == anew.names
    assert same.fitted["moments"] is table.fitted["moments"]

    def compute(*_):
        raise AssertionError("it is known")

    monkeypatch.setattr("servoscope.pipeline.feature_table._compute", compute)
    again = FeatureTable.fit(plane.images, Y, names[::-1], learn, known=table, n_jobs=1)
    assert sorted(again.names) == sorted(table.names)
    np.testing.assert_array_equal(
        again.values[:, [again.names.index(n) for n in table.names]], table.values
    )
