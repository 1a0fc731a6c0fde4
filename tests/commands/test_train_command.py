"""``servoscope train``: what its model is made of."""

from dataclasses import replace

import numpy as np

from planar import planar_data_set
from servoscope.cli import main
from servoscope.errors import DataSetError


def test_the_union_of_several_sets_is_trained(tmp_path, capsys, monkeypatch):
    data = planar_data_set(60, 16)
    darker = replace(data, images=data.images // 2, reference_image=data.reference_image // 2)
    parts = {"a": data[:20], "b": darker[20:40], "c": data[40:]}
    for name, part in parts.items():
        part.save(tmp_path / name)
    trained = []

    def train(data, **_):
        trained.append(data)
        raise DataSetError("Enough is known.")

    monkeypatch.setattr("servoscope.positioning.training.train", train)
    command = ["train", str(tmp_path / "a"), "--add", str(tmp_path / "b")]
    assert main([*command, "--add", str(tmp_path / "c"), "--out", str(tmp_path / "model")]) == 1
    assert "Enough is known." in capsys.readouterr().err
    np.testing.assert_allclose(trained[0].T_world_cam, data.T_world_cam, atol=1e-12)
    np.testing.assert_array_equal(trained[0].images[20:40], darker.images[20:40])
    np.testing.assert_array_equal(trained[0].reference_image, data.reference_image)


def test_sets_that_do_not_fit_are_refused_before_training(tmp_path, capsys):
    planar_data_set(20, 16).save(tmp_path / "a")
    planar_data_set(20, 20).save(tmp_path / "b")
    command = ["train", str(tmp_path / "a"), "--add", str(tmp_path / "b")]
    assert main([*command, "--out", str(tmp_path / "model")]) == 1
    assert "images of 16 x 16 px and the other images of 20 x 20 px" in capsys.readouterr().err
    assert not (tmp_path / "model").exists()
