"""The shapes of torques that a mechanism's variables may predict."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.measure import structure as measure
from zendsp.diagnosis.measure.structure import STRUCTURED, drawn, ranges_of, structure


def test_shapes_are_drawn_once_whatever_model_they_are_compared_with(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = model_of(VISCOUS, COULOMB)
    reference = reality.multisine(8.0, RATE, 3)
    columns = reality.simulate(reality.Machine(), reference, RATE)
    half = len(reference) // 2
    parts = [data_of({k: x[a : a + half] for k, x in columns.items()}, model) for a in (0, half)]
    first = structure(parts, model, 1, STRUCTURED)
    asked: list[Any] = []
    shapes = measure.shapes
    monkeypatch.setattr(measure, "shapes", lambda *a: asked.append(a) or shapes(*a))
    other = model_of(VISCOUS, COULOMB)
    assert structure(parts, other, 1, STRUCTURED) == first and not asked
    rec = parts[0].records[0]
    ranges = ranges_of(parts[0], 1)  # others than those of both parts
    own = drawn(rec, 1, STRUCTURED[:2], ranges, 1)
    assert len(asked) == 2
    assert np.array_equal(own, drawn(rec, 1, STRUCTURED[:2], ranges, 1)) and len(asked) == 2
    assert not pickle.loads(pickle.dumps(rec[0])).shapes
