from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from support.checkpoint_samples import META
from support.states import same

from karolos.checkpoint import load, save
from karolos.checkpoint.state_file import decode, encode


def test_state_of_an_agent_comes_back_bit_for_bit(tmp_path: Path) -> None:
    network = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.BatchNorm1d(4))
    optimiser = torch.optim.Adam(network.parameters())
    network(torch.rand(5, 3)).sum().backward()
    optimiser.step()
    generators = {kind.__name__: kind(3).state for kind in (np.random.PCG64, np.random.MT19937, np.random.Philox)}
    state = {
        "network": dict(network.state_dict()),
        "optimiser": optimiser.state_dict(),
        "generators": generators,
        "torch": torch.Generator().manual_seed(3).get_state(),
        "bf16": torch.ones(3, dtype=torch.bfloat16),
        "numbers": (1, -(2**127), 2**63, -(2**63), 0.1, -0.0, float("inf"), True, None, "text", np.float32(0.1)),
    }
    save(tmp_path, "last", {"agent": state}, META)
    parts, meta = load(tmp_path, "last")
    assert same(parts["agent"], state)
    assert meta == META
    network.load_state_dict(parts["agent"]["network"])
    optimiser.load_state_dict(parts["agent"]["optimiser"])


def test_generator_goes_on_where_it_stopped(tmp_path: Path) -> None:
    generator = np.random.default_rng(5)
    generator.random(7, np.float32)
    save(tmp_path, "last", {"buffer": {"generator": generator.bit_generator.state}}, {})
    expected = generator.random(9)
    fresh = np.random.default_rng()
    fresh.bit_generator.state = load(tmp_path, "last")[0]["buffer"]["generator"]
    assert np.array_equal(fresh.random(9), expected)


simple_arrays = arrays.arrays(
    st.one_of(arrays.scalar_dtypes(), arrays.unicode_string_dtypes(), arrays.byte_string_dtypes()),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
leaves = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), simple_arrays)
states = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.one_of(st.text(max_size=5), st.integers(-9, 9)), inner, max_size=3),
    ),
    max_leaves=8,
)


@given(states)
def test_any_state_survives_encoding(state: Any) -> None:
    assert same(decode(encode(state)), state)


def test_array_in_any_memory_order_comes_back(tmp_path: Path) -> None:
    base = np.arange(12, dtype=">i4").reshape(3, 4)
    frozen = base.copy()
    frozen.flags.writeable = False
    state = {"t": base.T, "fortran": np.asfortranarray(base), "strided": base[::2, ::-1], "frozen": frozen}
    save(tmp_path, "last", {"buffer": state}, {})
    found = load(tmp_path, "last")[0]["buffer"]
    assert all(np.array_equal(found[key], state[key]) and found[key].dtype == ">i4" for key in state)


def test_view_does_not_drag_its_storage_along(tmp_path: Path) -> None:
    large = torch.zeros(1_000_000)
    path = save(tmp_path, "last", {"agent": {"view": large[3:7]}}, {})
    assert (path / "agent.pt").stat().st_size < 10_000
    assert torch.equal(load(tmp_path, "last")[0]["agent"]["view"], large[3:7])


@pytest.mark.parametrize(
    ("state", "where"),
    [
        ({"a": {"b": [1, {2}]}}, r"agent\.a\.b\[1\]: a checkpoint holds no set"),
        ({"f": print}, r"agent\.f: a checkpoint holds no builtin"),
        ({"x": np.array([None])}, r"agent\.x: a checkpoint holds no array of object"),
        ({"x": np.zeros(2, [("a", "f4")])}, r"agent\.x: a checkpoint holds no array"),
        ({"__karolos__": 1}, "agent: keys"),
        ({(1, 2): 1}, "agent: keys"),
    ],
)
def test_what_cannot_be_kept_is_refused_by_its_path(tmp_path: Path, state: Any, where: str) -> None:
    with pytest.raises(TypeError, match=where):
        save(tmp_path, "last", {"agent": state}, {})
    assert list(tmp_path.iterdir()) == []
