"""A small model, and what is said of it once it is read."""

import json

import numpy as np
import pytest

from servoscope.errors import ModelError
from servoscope.storage.model_folder import read_model

HEADER = {"image_size": 64, "reach": [0.025, 1e-300, -0.1], "trained_on": {"part": "µ"}, "x": None}
CONTENT = {
    "coarse/tx.weights": np.linspace(-1.0, 1.0, 12, dtype=np.float32).reshape(3, 4),
    "scale": np.float64(0.1),
    "columns": np.arange(5),
    "mask": np.array([[True], [False]]),
    "image": np.arange(6, dtype=np.uint8).reshape(2, 3),
    "none": np.empty((0, 7)),
}


def assert_as_written(read):
    header, arrays = read
    assert json.dumps(header, sort_keys=True) == json.dumps(HEADER, sort_keys=True)
    assert arrays.keys() == CONTENT.keys()
    for name, array in CONTENT.items():
        assert arrays[name].dtype == array.dtype
        assert arrays[name].shape == array.shape
        assert arrays[name].tobytes() == array.tobytes()


def assert_refused(model, match):
    with pytest.raises(ModelError, match=match) as caught:
        read_model(model)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 700
