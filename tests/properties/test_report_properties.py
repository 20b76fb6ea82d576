"""What holds for any content of the report."""

import base64
import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadsight.report.document import embedded
from roadsight.report.packing import pack, pack_points, thin
from roadsight.report.wording import number, percent

coordinates = st.floats(-1e5, 1e5, width=32)
clouds = st.integers(0, 60).flatmap(lambda n: arrays(np.float64, (n, 3), elements=coordinates))
texts = st.recursive(st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


@given(st.lists(st.integers(0, 2**32 - 1)))
def test_integers_come_back(values):
    packed = pack(values, "u4")
    assert np.frombuffer(base64.b64decode(packed["data"]), "<u4").tolist() == values


@given(clouds)
def test_points_come_back_within_half_a_step(xyz):
    packed = pack_points(xyz)
    steps = np.frombuffer(base64.b64decode(packed["xyz"]["data"]), "<u2").reshape(-1, 3)
    back = np.array(packed["offset_m"]) + steps * packed["step_m"]
    assert np.all(np.abs(back - xyz) <= np.array(packed["step_m"]) * 0.5 * (1 + 1e-9) + 1e-9)


@given(clouds, st.integers(8, 40))
def test_thinned_points_are_few_and_ordered(xyz, at_most):
    kept = thin(xyz, at_most)
    assert len(kept) <= at_most
    assert np.all(np.diff(kept) > 0)
    assert (len(kept) > 0) == (len(xyz) > 0)
    if len(xyz) <= at_most:
        assert len(kept) == len(xyz)


@given(texts)
def test_embedded_content_comes_back_and_cannot_end_its_script(content):
    text = embedded(content)
    assert "<" not in text
    assert json.loads(text) == content


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_numbers_keep_four_digits(value):
    shown = float(number(value).replace(",", "").replace("\u2212", "-"))
    assert abs(shown - value) <= 5.1e-4 * abs(value)


@given(st.floats(0, 1))
def test_percentages_never_claim_all_or_nothing(share):
    shown = percent(share)
    assert shown.startswith("0\u202f") == (share == 0)
    assert shown.startswith("100\u202f") == (share == 1)
