"""Which precision and device a name means."""

import pytest
import torch

from karolos.agents.device import uses_bfloat16


@pytest.mark.parametrize(
    ("capabilities", "low"),
    [({"avx512_bf16": True}, True), ({"amx_bf16": True, "avx512_bf16": False}, True), ({"avx2": True}, False)],
)
def test_bfloat16_is_taken_by_name_and_by_auto_only_where_the_cpu_computes_in_it(capabilities, low, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    assert uses_bfloat16("auto", "cpu") is low
    assert not uses_bfloat16("auto", "cuda")
    assert uses_bfloat16("bfloat16", "cpu"), "it is named"
    assert not uses_bfloat16("float32", "cpu")
