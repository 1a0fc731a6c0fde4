"""What scikit-learn asks of every family, and what every family promises about images."""

from sklearn.utils.estimator_checks import parametrize_with_checks

import servoscope as sv

# Nothing is skipped: the families pass every check. Bases are kept small because the checks use
# flat "images" of as few as two pixels.
CHECKED = (
    sv.GeometricMoments(),
    sv.Eigenfeatures(n_components=1),
    sv.PoseImageCovariance(),
    sv.LocalFeatureAnalysis(n_components=1, n_per_dof=1, window=2),
)


@parametrize_with_checks(list(CHECKED))
def test_scikit_learn_estimator_checks(estimator, check):
    check(estimator)
