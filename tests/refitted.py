"""Features that are fitted anew without each part of the images, and what they forecast."""

from copy import deepcopy

import numpy as np

from servoscope.selection.forecast import Fold, cut_folds, forecast_from_folds


def refit_features(family, images, Y, *, groups=None, n_folds=5):
    folds = []
    for left_out in cut_folds(np.asarray(Y, float).reshape(len(Y), -1), groups, n_folds):
        used = np.delete(np.arange(len(images)), left_out)
        fitted = deepcopy(family).fit(images[used], Y[used])
        folds.append(Fold(left_out, fitted.transform(images)))
    return folds


def crossfit_forecast(family, images, Y, *, groups=None, n_folds=5):
    folds = refit_features(family, images, Y, groups=groups, n_folds=n_folds)
    return forecast_from_folds(folds, Y, groups=groups)
