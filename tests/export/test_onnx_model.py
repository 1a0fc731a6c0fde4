"""An exported model says what the model says, and its card says how nearly."""

import hashlib
import json

import numpy as np
import pytest

from servoscope.cli import main
from servoscope.dofs import mask_of
from servoscope.errors import FolderExistsError, InvalidInputError, ModelError
from servoscope.export.agreement import Agreement, OnnxEstimator
from servoscope.export.onnx_model import OUTPUTS, export_onnx, to_onnx
from servoscope.positioning import PositioningModel
from small_keyframe import shown, small_model, texture

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def model():
    return small_model((96, 128))


@pytest.fixture(scope="module")
def exported(model, tmp_path_factory):
    file = tmp_path_factory.mktemp("onnx") / "model.onnx"
    return export_onnx(model, file, images=shown(model, 8), n_check=4)


def assert_equal(model, estimator, images):
    for image in images:
        ours, theirs = model.estimate(image), estimator(image)
        assert {name: np.shape(x) for name, x in theirs.items()} == OUTPUTS
        np.testing.assert_allclose(theirs["displacement"], ours.displacement, atol=2e-7)
        np.testing.assert_allclose(theirs["deviation"], ours.std, rtol=0.02, atol=1e-8)
        assert abs(float(theirs["similarity"]) - ours.similarity) < 1e-4
        assert bool(theirs["is_recognised"]) == ours.is_recognised


@pytest.fixture(scope="module")
def estimator(exported):
    return OnnxEstimator(exported.path)


def test_both_read_the_same(model, estimator):
    assert_equal(model, estimator, shown(model))


def test_what_is_not_the_part_is_not_recognised(model, estimator):
    other = texture((96, 128), 77).astype(np.uint8)
    assert not estimator(other)["is_recognised"]
    assert not model.estimate(other).is_recognised


@pytest.mark.parametrize(
    "options",
    [
        {"dofs": ("tx", "ty", "rz"), "reads": ("tx", "ty", "tz", "rz")},
        {"depth": 1e-6},
        {"dofs": ("rx", "rz"), "depth": 1e-6, "guesses": False},
    ],
    ids=["few_dofs", "far", "far_turns"],
)
def test_models_of_every_kind_read_the_same(options):
    model = small_model(**options)
    estimator, images = OnnxEstimator(to_onnx(model)), shown(model)
    assert_equal(model, estimator, images)
    found = estimator(images[1])
    assert not found["delta_p"][~mask_of(model.dofs)].any()
    np.testing.assert_array_equal(np.isfinite(found["deviation"]), mask_of(model.dofs))


def test_the_agreement_is_measured(exported):
    found = exported.agreement
    assert found.n_images == 1 + 4 + 9
    assert found.equal > 0.9
    assert 0 < found.worst_share < 0.1


def test_an_agreement_sees_a_graph_of_another_model(model, estimator):
    other = small_model((96, 128), depth=1.5)
    assert Agreement.between(other, estimator, shown(model)[1:], 0).worst_share > 0.1


def test_the_file_holds_standard_operators_and_what_is_to_be_known(model, exported):
    proto = onnx.load(exported.path)
    assert {opset.domain for opset in proto.opset_import} == {""}
    facts = {entry.key: entry.value for entry in proto.metadata_props}
    assert json.loads(facts["reach"]) == model.reach.tolist()
    assert json.loads(facts["least_similarity"]) == 0.8
    assert exported.size_mb < 5


def test_the_card_says_what_was_measured(exported):
    card = exported.card.read_text()
    assert hashlib.sha256(exported.path.read_bytes()).hexdigest() in card
    assert f"on {exported.agreement.n_images} images" in card
    assert "| tx | yes | +-20 mm | 0.1 mm | 0.3 mm |" in card
    assert f"{exported.agreement.equal:.0%}" in card


def test_equal_models_give_equal_files(model, exported):
    assert to_onnx(model) == exported.path.read_bytes()


def test_a_file_is_replaced_only_by_force(model, exported):
    before = exported.path.read_bytes()
    with pytest.raises(FolderExistsError, match="--force"):
        export_onnx(model, exported.path, n_check=0)
    assert exported.path.read_bytes() == before


def test_a_model_of_features_is_refused_in_a_line(tmp_path, plane):
    from servoscope.positioning.feature_model import FeatureModel

    features = object.__new__(FeatureModel)
    with pytest.raises(ModelError, match=r"^Only keyframe models.*features.*servoscope serve\.$"):
        export_onnx(features, tmp_path / "model.onnx")
    assert not any(tmp_path.iterdir())


def test_images_of_another_size_are_refused(model, estimator):
    with pytest.raises(InvalidInputError, match="128 x 96"):
        Agreement.between(model, estimator, np.zeros((1, 8, 8), np.uint8), 0)


def test_the_command_writes_the_file_and_its_card(tmp_path, capsys):
    small_model(guesses=False).save(tmp_path / "model")
    file = tmp_path / "model.onnx"
    arguments = ["export", str(tmp_path / "model"), str(file), "--check", "1", "--json"]
    assert main(arguments) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert facts["agreement"]["images"] == 2
    assert (tmp_path / "model.onnx.md").exists()
    assert to_onnx(PositioningModel.load(tmp_path / "model")) == file.read_bytes()
    assert main(arguments) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_an_ending_that_says_of_no_format_is_refused(tmp_path, capsys):
    assert main(["export", str(tmp_path), str(tmp_path / "model.xyz")]) == 1
    assert ".onnx" in capsys.readouterr().err
