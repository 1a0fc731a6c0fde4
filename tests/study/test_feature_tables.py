import numpy as np
import pytest

from servoscope.features import GeometricMoments, compute_image_basis
from servoscope.pipeline import FeatureTable
from servoscope.poses import DOFS
from servoscope.study.information import CANDIDATES, compute_feature_table
from servoscope.study.paper import FAMILIES


@pytest.fixture(scope="module")
def table(plane) -> FeatureTable:
    train = np.arange(100)
    moments = GeometricMoments().fit_transform(plane.images)
    basis = compute_image_basis(plane.images[train], 85)
    return compute_feature_table(plane, moments, basis, train, "pivot")[0]


def names(table, columns) -> list[str]:
    return [table.names[i] for i in columns]


@pytest.mark.parametrize("dof", DOFS)
def test_nets_take_24_moments_24_eigenfeatures_6_pci_and_12_lfa_features(table, dof):
    taken = {f: names(table, table.columns(one.recipe.for_dof(dof))) for f, one in FAMILIES.items()}
    assert len(set(taken["gm"])) == 24
    assert {name.split("_")[1] for name in taken["gm"]} == {"50", "100", "150"}
    assert taken["pca"] == [f"e_{i:02d}" for i in range(24)]
    assert taken["pci"] == [f"pci_{dof}" for dof in DOFS]
    for family in ("lfa35", "lfa85"):
        assert taken[family] == [f"{family}_{dof}_{i:02d}" for i in range(12)]


def test_selection_chooses_from_24_moments_35_eigenfeatures_and_6_pci_features(table):
    candidates = names(table, table.columns(CANDIDATES))
    assert len(candidates) == 24 + 35 + 6
    assert [name for name in candidates if name.startswith("e_")] == [
        f"e_{i:02d}" for i in range(35)
    ]
