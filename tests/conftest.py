import hypothesis
import numpy as np
import pytest

# The first call of a numba kernel compiles it, and other machines are slower: no deadline.
hypothesis.settings.register_profile("servoscope", deadline=None)
hypothesis.settings.load_profile("servoscope")


@pytest.fixture
def rng():
    return np.random.default_rng(0)
