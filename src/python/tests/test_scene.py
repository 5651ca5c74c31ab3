"""Scenes from everything that one can be made from, and refusals with the engine's words."""

import numpy as np
import pytest

import whirls
from conftest import small


def test_a_scene_from_a_name_a_text_a_dict_and_a_path_is_the_same(tmp_path):
    named = small("inverse-2d")
    text = named.to_toml()
    path = tmp_path / "scene.toml"
    path.write_text(text)
    tables = {"name": "mine", "dimension": 2, "fluid": {"particles_per_side": 8, "smoothing_length": 0.8, "c": 10,
              "alpha": 1.0, "beta": 2.0, "gamma": 7.0}, "time": {"courant": 0.3}}
    assert whirls.Scene(text).to_toml() == whirls.Scene(path).to_toml() == text
    own = whirls.Scene(tables, {"fluid.c": np.float64(12.0), "forcing": {"kind": "stochastic", "interval": 0.05}})
    assert own.parameters["c"] == 12.0 and own.particles == 64 and own.name == "mine"
    assert whirls.Scene(own.to_toml()).to_toml() == own.to_toml()
    assert set(whirls.shipped()) >= {"inverse-2d", "node-3d"}


def test_overrides_replace_keys_and_keep_the_neighbours():
    scene = small("inverse-2d")
    finer = scene.replace({"fluid.particles_per_side": 16})
    assert finer.smoothing_length == pytest.approx(scene.smoothing_length / 2)
    assert finer.mass == pytest.approx(np.prod(finer.sides) / 256)
    assert scene.learned == ["c", "alpha", "beta", "gamma"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: whirls.Scene("inverse-2d", {"fluid.viscous": 1}), "viscous"),
        (lambda: whirls.Scene("inverse-2d", {"fluid.c": -1.0}), "fluid.c"),
        (lambda: whirls.Scene("inverse-4d"), "inverse-3d"),
        (lambda: whirls.rollout(3, steps=1), "whirls.Scene"),
    ],
)
def test_what_is_no_scene_is_refused_with_what_was_expected_and_found(make, words):
    with pytest.raises(whirls.InputError) as caught:
        make()
    assert words in str(caught.value) and caught.value.expected and caught.value.remedy
    assert isinstance(caught.value, ValueError) and isinstance(caught.value, whirls.Error)


def test_a_missing_file_is_an_os_error():
    with pytest.raises(whirls.FileError) as caught:
        whirls.Scene("/nowhere/scene.toml")
    assert isinstance(caught.value, OSError) and caught.value.path == "/nowhere/scene.toml"


def test_nearest_images_are_within_half_a_period_along_periodic_axes_only():
    scene = small("inverse-2d", fluid__boundary=["periodic", "open"])
    side = scene.sides[0]
    assert scene.periods.tolist() == [side, np.inf]
    found = scene.nearest_image(np.array([[0.9 * side, 0.9 * side], [-0.6 * side, 0.1]]))
    np.testing.assert_allclose(found, [[-0.1 * side, 0.9 * side], [0.4 * side, 0.1]])


def test_weights_are_drawn_from_a_seed():
    scene = small("rot-inv-2d")
    assert scene.weights().shape == scene.weights(5).shape and not np.array_equal(scene.weights(), scene.weights(5))
    assert small("inverse-2d").weights().size == 0
