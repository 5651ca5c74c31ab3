"""What the documentation shows runs as it is shown."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

import whirls

README = Path(__file__).parents[3] / "README.md"
MODULES = ["_scene", "_flow", "_rollout", "_learn", "jax", "torch"]


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_a_module(name):
    if name in ("jax", "torch"):
        pytest.importorskip(name)
    found = doctest.testmod(importlib.import_module(f"whirls.{name}"), extraglobs={"whirls": whirls})
    assert found.failed == 0
    assert found.attempted > 0


def blocks(path):
    section = re.search(r"^## From Python\n(.*?)^## ", path.read_text(), re.S | re.M)
    return re.findall(r"^```python\n(.*?)^```", section[1], re.S | re.M)


def test_readme_runs(tmp_path, monkeypatch):
    """With fewer particles than it shows, in one namespace, block after block."""
    jax = pytest.importorskip("jax")
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in blocks(README):
        exec(block.replace('"fluid.particles_per_side": 16', '"fluid.particles_per_side": 6'), names)
    assert set(names["by"]) == {"c", "alpha"} and names["by_r0"].shape == names["truth"].r[0].shape
    assert all(jax.numpy.isfinite(value) for value in names["by"].values())
