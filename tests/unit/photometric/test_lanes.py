"""Polynomials that stand for library calls."""

import numpy as np

from treadlight.photometric.lanes import log2


def test_logarithm_is_that_of_the_library():
    x = np.concatenate([np.linspace(0.02, 2, 500), 2.0 ** np.arange(-120, 120, 7)])
    found = np.array([log2(value) for value in x.astype(np.float32)])
    expected = np.log2(x.astype(np.float32).astype(float))
    np.testing.assert_allclose(found, expected, rtol=2e-7, atol=3e-7)
    assert log2(np.float32(1.0)) == 0.0
