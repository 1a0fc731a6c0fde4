"""A model of features is exported as a graph that reads what it reads; others are refused."""

import numpy as np
import pytest

from servoscope.data.splits import split_images
from servoscope.errors import ModelError
from servoscope.export.agreement import Agreement
from servoscope.export.onnx_estimator import OnnxEstimator
from servoscope.export.onnx_model import OUTPUTS, export_onnx, to_onnx
from servoscope.pipeline import PosePipeline, Recipe
from servoscope.poses import DOFS
from servoscope.positioning.feature_model import FeatureModel

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

RECIPES = {
    "tx": Recipe("moments+gradient"),
    "ty": Recipe("eigenfeatures", regressor="levenberg_marquardt"),
    "tz": Recipe("projections"),
    "rx": Recipe("intensity", regressor="kernel_ridge"),
    "ry": Recipe("log_polar", regressor="lbfgs"),
    "rz": Recipe("pose_covariance+least_squares"),
}


def model_of(data, recipes):
    dofs = tuple(recipes)
    targets = data.delta_p()[:, [DOFS.index(dof) for dof in dofs]]
    split = split_images(len(data), "honest", 0)
    pipeline = PosePipeline(recipes, dofs).fit(data.images, targets, split)
    pipeline.record_["pivot"] = data.pivot
    return FeatureModel.of_pipeline(pipeline, data, np.arange(len(data)))


@pytest.fixture(scope="module")
def model(plane):
    return model_of(plane[:80], RECIPES)


@pytest.fixture(scope="module")
def exported(model, plane, tmp_path_factory):
    file = tmp_path_factory.mktemp("onnx") / "model.onnx"
    return export_onnx(model, file, images=plane.images[model.pipeline.split_.test], n_check=4)


def test_both_read_the_same_of_every_image(model, exported, plane):
    estimator = OnnxEstimator(exported.path)
    for image in plane.images[model.pipeline.split_.test]:
        ours, theirs = model.estimate(image), estimator.outputs(image)
        assert {name: np.shape(x) for name, x in theirs.items()} == OUTPUTS
        np.testing.assert_allclose(
            theirs["displacement"], ours.displacement, atol=0.01 * np.nanmin(ours.std)
        )
        np.testing.assert_allclose(theirs["deviation"], ours.std, rtol=0.01)
        np.testing.assert_allclose(theirs["novelty"], ours.novelty, rtol=1e-3)
        assert bool(theirs["is_recognised"]) == ours.is_recognised
        assert np.isnan(theirs["similarity"])
    assert exported.agreement.worst_share < 0.02


def test_the_card_says_what_is_not_recognised(exported):
    assert "other features than the part has" in exported.card.read_text()


def test_other_dofs_stay_as_they_are(plane):
    model = model_of(plane, {"tx": Recipe("moments"), "rz": Recipe("moments")})
    found = OnnxEstimator(to_onnx(model)).outputs(plane.images[0])
    np.testing.assert_array_equal(found["delta_p"][[1, 2, 3, 4]], 0)
    np.testing.assert_array_equal(np.isfinite(found["deviation"]), [1, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(
        found["displacement"], model.estimate(plane.images[0]).displacement, atol=1e-6
    )


def test_an_agreement_sees_a_graph_of_another_model(model, plane, exported):
    other = model_of(plane[80:], RECIPES)
    estimator = OnnxEstimator(exported.path)
    assert Agreement.between(other, estimator, plane.images[:10], 0).worst_share > 0.02


@pytest.mark.filterwarnings("ignore:Images of something else may be taken")
@pytest.mark.parametrize(
    ("recipe", "named"),
    [
        (Recipe("tchebichef"), "features tchebichef have no ONNX form"),
        (Recipe("moments", regressor="bayesian_lm"), "BayesianLMRegressor has no ONNX form"),
    ],
)
def test_what_has_no_form_is_named_in_a_line(plane, tmp_path, recipe, named):
    model = model_of(plane[:40], {"tx": recipe})
    with pytest.raises(ModelError, match=rf"^.*{named}.*servoscope serve\.$"):
        export_onnx(model, tmp_path / "model.onnx")
    assert not any(tmp_path.iterdir())
