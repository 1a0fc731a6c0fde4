import copy

import pytest

from servoscope.poses import DOFS
from servoscope.study.agreement import (
    closeness_to_paper,
    compare_with_paper,
    explain_differences,
)
from servoscope.study.results import list_units


def verdicts(summary):
    return {finding.claim: finding.verdict for finding in compare_with_paper(summary)}


def find(summary, words):
    (finding,) = [f for f in compare_with_paper(summary) if words in f.claim]
    return finding


def change(summary, edit, forms=("pivot", "camera"), protocols=("paper",)):
    changed = copy.deepcopy(summary)
    for protocol in protocols:
        for form in forms:
            edit(changed["protocols"][protocol][form])
    return changed


def worsen(family, by=1.0):
    def edit(results):
        for dof in DOFS:
            results["table1"][family][dof]["rms"] += by

    return edit


def other_order(results):
    for dof in DOFS:
        results["stability"][dof][3]["same_steps"] = 1


def uninformative(results):
    for dof in DOFS:
        errors = results["table3"][dof]["rms"]
        for row in results["mi"].values():
            row[dof] = errors


def large_subset_errors(results):
    for dof in DOFS:
        results["table3"][dof]["rms"] += 0.3


def good_translations(results):
    for dof in DOFS[:3]:
        results["table3"][dof]["rms"] = 0.001


def other_features(results):
    results["table2"] = {dof: [f"lfa_{i}" for i in range(24)] for dof in DOFS}


def other_null(results):
    results["mi_null_level"] = 0.5


CLAIMS = {
    "dofs, geometric moments are best": (worsen("gm"), "no"),
    "PCI is better than PCA": (worsen("pci"), "no"),
    "Geometric moments are best for every": (worsen("gm"), "no"),
    "LFA from 85": (worsen("lfa35"), "no"),
    "predicts which": (uninformative, "no"),
    "A selected subset does as well": (large_subset_errors, "no"),
    "same for 5 to 20 bins": (other_order, "no"),
    "Translations are less accurate": (good_translations, "no"),
    "err no more than published": (large_subset_errors, "no"),
    "The same 24 features": (other_features, "no"),
    "selected first": (other_features, "no"),
    "0.1 bits is typical": (other_null, "no"),
}


def test_published_numbers_bear_out_every_published_statement(summary):
    found = verdicts(summary)
    # the published errors themselves are larger than those of the moments for three dofs
    partly = "A selected subset does as well as the 24 moments, with no more features."
    assert found.pop(partly) == "partly"
    assert set(found.values()) == {"yes"}


@pytest.mark.parametrize("words", CLAIMS)
def test_each_statement_can_be_denied(summary, words):
    edit, verdict = CLAIMS[words]
    assert find(change(summary, edit), words).verdict == verdict


def test_forms_that_disagree_make_partly(summary):
    finding = find(change(summary, other_order, forms=("camera",)), "5 to 20 bins")
    assert finding.verdict == "partly"
    assert "6 of 6" in finding.evidence[0]
    assert "from step 2 (8 bins)" in finding.evidence[1]


def test_pci_worse_than_pca_is_said_with_the_means(summary):
    finding = find(change(summary, worsen("pci")), "PCI is better than PCA")
    assert finding.verdict == "no"
    assert "PCA 0.252 (0.252), PCI 1.182 (0.182)" in finding.evidence[0]


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "yes"), (1.1, "partly"), (1.5, "no")])
def test_optimism_is_measured_by_how_much_honest_errors_are_larger(summary, factor, verdict):
    def edit(results):
        for dof in DOFS:
            results["table3"][dof]["rms"] *= factor

    finding = find(change(summary, edit, protocols=("honest",)), "does not flatter")
    assert finding.verdict == verdict
    assert f"{factor - 1:+.0%}" in finding.evidence[0]


def test_one_protocol_alone_has_no_optimism(summary):
    del summary["protocols"]["paper"]
    assert not [claim for claim in verdicts(summary) if "flatter" in claim]


def test_the_papers_protocol_is_the_one_compared(summary):
    changed = change(summary, worsen("gm"), protocols=("honest",))
    assert find(changed, "Geometric moments are best").verdict == "yes"


def test_another_scene_is_compared_in_general_statements_only(summary):
    all_claims = set(verdicts(summary))
    summary["dataset"]["source"] = {"format": "tum"}
    left_out = all_claims - set(verdicts(summary))
    assert len(left_out) == 4
    assert "The same feature is selected first." in left_out
    assert "not of a cylinder head" in explain_differences(summary)[0]


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"rings": "400@1.0", "robot": "free", "part": "cylinder_head", "variant": 3}, True),
        ({"rings": "1000@1.0,400@0.2"}, False),
        ({"rings": "1000@0.2"}, False),
        ({"robot": "arm"}, False),
        ({"kind": "simulated textured plane", "part": "textured_plane"}, False),
        ({"translation_mm": 10.0}, False),
        ({"pivot_mm": 0.0}, False),
    ],
)
def test_only_images_as_the_papers_are_compared_with_its_numbers(summary, change, same):
    all_claims = set(verdicts(summary))
    summary["dataset"]["source"] |= change
    assert (set(verdicts(summary)) == all_claims) == same
    reasons = " ".join(explain_differences(summary))
    assert ("differ from the published ones by a typical factor" in reasons) == same
    assert ("not of a cylinder head under the published poses" in reasons) != same


def test_closeness_is_zero_for_the_published_table_and_one_for_its_double(summary):
    (unit, *_) = list_units(summary)
    assert closeness_to_paper(unit) == 0.0
    for row in unit.results["table1"].values():
        for cell in row.values():
            cell["rms"] *= 2
    assert closeness_to_paper(unit) == pytest.approx(1.0)
