import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treadlight.rounding import keep_bits


@pytest.mark.parametrize("width", [32, 64])
@settings(deadline=None)  # The first example compiles.
@given(data=st.data(), bits=st.integers(3, 20))
def test_values_are_rounded_to_the_next_with_so_many_bits(width, data, bits):
    largest = 2.0**100
    value = data.draw(st.floats(-largest, largest, width=width, allow_subnormal=False))
    kept = np.array([value], f"f{width // 8}")
    keep_bits(kept, bits)
    found = float(kept[0])
    assert abs(found - value) <= 2.0 ** -(bits + 1) * abs(value)
    mantissa, _ = np.frexp(found)
    assert (mantissa * 2.0 ** (bits + 1)).is_integer()


def test_what_is_not_finite_stays():
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0], np.float32)
    odd = np.append(odd, np.array([0x7FFFFFFF], np.uint32).view(np.float32))
    before = odd.view(np.uint32).copy()
    keep_bits(odd, 5)
    np.testing.assert_array_equal(odd.view(np.uint32), before)


def test_large_arrays_of_any_shape_are_rounded_whole(rng):
    values = rng.normal(size=(700, 500, 3)).astype(np.float32)
    kept = values.copy()
    keep_bits(kept, 12)
    np.testing.assert_allclose(kept, values, rtol=2.0**-13, atol=0)
    assert not (kept.view(np.uint32) & 0x7FF).any()


def test_what_would_be_rounded_in_a_copy_is_refused():
    with pytest.raises(ValueError, match="contiguous"):
        keep_bits(np.zeros((4, 6), np.float32).T, 5)
