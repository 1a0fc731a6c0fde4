"""Families of one's own, against scipy's transform and scikit-learn's ridge regression."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import dctn
from sklearn.linear_model import Ridge

import servoscope as sv

SCRIPT = Path(__file__).parents[2] / "examples" / "more_features.py"


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(SCRIPT))


def test_cosines_are_those_of_scipy(example, plane):
    images = plane.images[:3]
    cosines = example["CosineCoefficients"](order=2).fit(images)
    assert cosines.get_feature_names_out().tolist() == [
        "c_00",
        "c_10",
        "c_01",
        "c_20",
        "c_11",
        "c_02",
    ]
    for image, found in zip(images, cosines.transform(images), strict=True):
        whole = dctn(image / np.linalg.norm(image), norm="ortho")
        np.testing.assert_allclose(found, [whole[j, i] for i, j in cosines.orders_], atol=1e-12)


def test_ridge_estimates_are_those_of_scikit_learn(example, plane):
    images, delta_p = plane.images, plane.delta_p()
    estimates = example["RidgeEstimates"]().fit(images, delta_p)
    rows = example["unit_length"](images)
    centred = rows - rows.mean(axis=0)
    level = 0.1 * np.sum(centred**2) / (len(rows) - 1)
    expected = Ridge(level).fit(rows, delta_p).predict(rows) - delta_p.mean(axis=0)
    np.testing.assert_allclose(estimates.transform(images), expected, atol=1e-9)
    again = example["RidgeEstimates"].from_arrays(estimates.to_arrays())
    np.testing.assert_array_equal(again.transform(images), estimates.transform(images))


def test_the_example_prints_a_row_a_family(example, plane, tmp_path, capsys):
    plane[:60].save(tmp_path / "data")
    example["main"](tmp_path / "data")
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
    names = ["moments", "intensity", "CosineCoefficients", "RidgeEstimates"]
    assert [row[0] for row in rows] == names
    assert all(len(row) == 1 + len(sv.DOFS) for row in rows)
