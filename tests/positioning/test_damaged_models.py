"""Whatever happens to the bytes of a model, it is read as it was written, or refused."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model_samples import CONTENT, HEADER, assert_as_written
from servoscope.errors import ModelError
from servoscope.storage.model_folder import ARRAYS, MODEL, read_model, write_model


@pytest.fixture
def model(tmp_path):
    write_model(tmp_path / "model", HEADER, CONTENT)
    return tmp_path / "model"


damages = st.lists(
    st.tuples(
        st.sampled_from(["flip", "cut", "insert", "delete", "repeat"]),
        st.floats(0.0, 1.0),
        st.binary(min_size=1, max_size=12),
    ),
    min_size=1,
    max_size=4,
)


def damage(data, kind, where, noise):
    i = int(where * len(data))
    return {
        "flip": data[:i] + noise + data[i + len(noise) :],
        "cut": data[:i],
        "insert": data[:i] + noise + data[i:],
        "delete": data[:i] + data[i + len(noise) :],
        "repeat": data[:i] + data[max(0, i - 64 * len(noise)) :],
    }[kind]


@pytest.mark.parametrize("part", [MODEL, ARRAYS])
@settings(
    max_examples=400,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(damages=damages)
def test_damaged_bytes_are_refused_or_make_no_difference(model, part, damages):
    whole = (model / part).read_bytes()
    data = whole
    for kind, where, noise in damages:
        data = damage(data, kind, where, noise)
    (model / part).write_bytes(data)
    try:
        assert_as_written(read_model(model))
    except ModelError:
        pass
    finally:
        (model / part).write_bytes(whole)


@pytest.mark.parametrize("part", [MODEL, ARRAYS])
def test_a_changed_bit_is_refused_or_makes_no_difference(model, part):
    whole = (model / part).read_bytes()
    n_refused = 0
    for i in range(0, len(whole), 3):
        changed = bytes([whole[i] ^ (1 << i % 8)])
        (model / part).write_bytes(whole[:i] + changed + whole[i + 1 :])
        try:
            assert_as_written(read_model(model))
        except ModelError:
            n_refused += 1
    assert n_refused > 0.15 * len(whole)
