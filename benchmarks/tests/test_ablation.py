"""Every row of the ablation switches off something that is there."""

from __future__ import annotations

from contextlib import ExitStack
from unittest import mock

import pytest

import ablation
from f3sr.pipeline_config import Config


@pytest.mark.parametrize("name", ablation.ROWS)
def test_what_a_row_replaces_exists(name: str):
    variant = ablation.ROWS[name]
    ablation.configured(Config(), variant.settings)
    with ExitStack() as stack:
        for stage in variant.instead:
            assert hasattr(ablation.pipeline, stage)
        for target, other in variant.patched.items():
            stack.enter_context(mock.patch(target, other))
