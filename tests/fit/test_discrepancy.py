from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FitError
from finray_calib.fit import PAINT_DISCREPANCY


@pytest.mark.parametrize("name", ["amplitude_rel", "floor_rel", "reabsorption_rel"])
@pytest.mark.parametrize("value", [-0.1, 1.0, np.nan, np.inf])
def test_shares_out_of_range_are_named(name, value):
    with pytest.raises(FitError, match=f"discrepancy: {name} {value:g} must be a share of 0 or more and below 1"):
        replace(PAINT_DISCREPANCY, **{name: value})


@pytest.mark.parametrize("value", [1.9, 201.0, np.nan, np.inf])
def test_lengths_out_of_range_are_named(value):
    with pytest.raises(FitError, match=f"discrepancy: length_nm {value:g} nm must lie between 2 and 200 nm"):
        replace(PAINT_DISCREPANCY, length_nm=value)
