"""An exported model says what the model says, and its card says how nearly."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from servoscope.cli import main
from servoscope.dofs import mask_of
from servoscope.errors import FolderExistsError, InvalidInputError, ModelError
from servoscope.export.agreement import Agreement
from servoscope.export.onnx_estimator import OnnxEstimator
from servoscope.export.onnx_model import OUTPUTS, export_onnx, to_onnx
from servoscope.keyframe.rendering import continued
from servoscope.poses import displacements_from_poses
from servoscope.positioning import LoopSettings, Positioner, PositioningModel
from servoscope.positioning.settings import NEAR_ENOUGH
from small_keyframe import displacements, shown, small_model, texture

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
        ours, theirs = model.estimate(image), estimator.outputs(image)
        assert {name: np.shape(x) for name, x in theirs.items()} == OUTPUTS
        np.testing.assert_allclose(theirs["displacement"], ours.displacement, atol=2e-8)
        product = theirs["displacement"] @ theirs["correction"]
        np.testing.assert_allclose(product, np.eye(4), atol=1e-12)
        np.testing.assert_allclose(theirs["deviation"], ours.std, rtol=1e-4, atol=1e-9)
        assert abs(float(theirs["similarity"]) - ours.similarity) < 1e-4
        np.testing.assert_allclose(theirs["novelty"], ours.novelty, atol=1e-5)
        assert bool(theirs["is_recognised"]) == ours.is_recognised


@pytest.fixture(scope="module")
def estimator(exported):
    return OnnxEstimator(exported.path)


def test_both_read_the_same(model, estimator):
    assert_equal(model, estimator, shown(model))


def test_what_is_not_the_part_is_not_recognised(model, estimator):
    other = texture((96, 128), 77).astype(np.uint8)
    assert not estimator.outputs(other)["is_recognised"]
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
    found = estimator.outputs(images[1])
    assert not found["delta_p"][~mask_of(model.dofs)].any()
    np.testing.assert_array_equal(np.isfinite(found["deviation"]), mask_of(model.dofs))


def test_the_agreement_is_measured(exported):
    found = exported.agreement
    assert found.n_images == 1 + 4 + 9
    assert found.equal == 1
    assert 0 < found.worst_share < 1e-3


def test_an_agreement_sees_a_graph_of_another_model(model, estimator):
    other = small_model((96, 128), depth=1.5)
    assert Agreement.between(other, estimator, shown(model)[1:], 0).worst_share > 0.1


def test_the_file_holds_standard_operators_and_what_is_to_be_known(model, exported):
    proto = onnx.load(exported.path)
    assert {opset.domain for opset in proto.opset_import} == {""}
    facts = {entry.key: entry.value for entry in proto.metadata_props}
    assert json.loads(facts["reach"]) == model.reach.tolist()
    assert json.loads(facts["least_similarity"]) == 0.8
    assert exported.size_mb < 6


def test_the_file_and_its_card_name_the_workspace_of_the_images(model, tmp_path):
    box = {"workspace": [[0.3, None, 0.1], [0.7, 0.2, None]]}
    limited = replace(model, first_guess=None, trained_on=box)
    exported = export_onnx(limited, tmp_path / "model.onnx", n_check=0)
    estimator = OnnxEstimator(exported.path)
    assert LoopSettings().robot_box(estimator) == LoopSettings().robot_box(limited)
    assert "inside x 300 to 700 mm, y -inf to 200 mm, z 100 to inf mm" in exported.card.read_text()
    facts = {e.key: e.value for e in onnx.load(exported.path).metadata_props}
    assert json.loads(facts["workspace"]) == [0.3, -1e6, 0.1, 0.7, 0.2, 1e6]
    assert json.loads(facts["tolerance"])[0] == pytest.approx(1e-3 * NEAR_ENOUGH["mm"])


def test_without_a_workspace_the_card_says_so(exported, estimator):
    assert "without a workspace" in exported.card.read_text()
    assert not LoopSettings().robot_box(estimator).is_limited


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


class Rendered:
    """A robot whose camera sees what the keyframe shows from where it is."""

    def __init__(self, model, displacement):
        self.keyframe, self.pose = model.keyframe, displacement
        self.rng = np.random.default_rng(0)

    def move(self, displacement):
        self.pose = self.pose @ displacement
        return displacement

    def read(self):
        grey = continued(*self.keyframe.render(self.pose)).astype(float)
        return np.rint(grey + self.rng.normal(size=grey.shape)).clip(0, 255).astype(np.uint8)


def test_the_file_drives_a_robot_to_the_reference(model, estimator):
    start = displacements(3, seed=8)[2]
    ends = []
    for reads in (estimator, model):
        robot = Rendered(model, start)
        result = Positioner(reads).run(robot, robot)
        assert result.status == "converged", result.message
        ends.append(displacements_from_poses(np.eye(4), robot.pose[None], model.pivot)[0])
    before = displacements_from_poses(np.eye(4), start[None], model.pivot)[0]
    assert np.linalg.norm(ends[0] / model.reach) < 0.1 * np.linalg.norm(before / model.reach)
    np.testing.assert_allclose(ends[0], ends[1], atol=0.02 * model.reach.min())


def test_the_file_knows_what_the_loop_needs(model, estimator):
    np.testing.assert_array_equal(estimator.reference_image, model.reference_image)
    np.testing.assert_array_equal(estimator.reach, model.reach)
    assert (estimator.pivot, estimator.dofs) == (model.pivot, model.dofs)
    assert estimator.image_shape == model.image_shape


@pytest.mark.parametrize("content", [b"", b"no graph", None])
def test_what_was_not_exported_is_refused_in_a_line(content, exported, tmp_path):
    if content is None:
        proto = onnx.load(exported.path)
        del proto.metadata_props[:]
        content = proto.SerializeToString()
    (tmp_path / "other.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=r"^.*not a model that servoscope exported.*$"):
        OnnxEstimator(tmp_path / "other.onnx")
