"""What learned methods have learned is kept, and read again as it was."""

from pathlib import Path

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.scoreboard.learners import LEARNERS


@pytest.mark.slow
def test_networks_are_read_as_they_were_written(tmp_path: Path) -> None:
    data = planar_data_set(120, size=32)
    networks = LEARNERS["networks"]
    model = networks.train(data, seed=0, n_jobs=1, on_progress=lambda n: None)
    for _ in range(2):  # the second one is in the place of the first
        networks.save(model, tmp_path / "model")
    read = networks.load(tmp_path / "model")
    for image in data.images[:5]:
        expected, got = (m.estimate(image, None) for m in (model, read))
        np.testing.assert_array_equal(got.displacement, expected.displacement)
        np.testing.assert_array_equal(got.std, expected.std)
        assert got.stage == expected.stage
    np.testing.assert_array_equal(read.reference_image, model.reference_image)
    assert read.pivot == model.pivot
