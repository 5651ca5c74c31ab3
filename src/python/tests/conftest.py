"""Small flows that the tests share."""

import pytest

import whirls

SMALL = {"inverse-2d": 8, "inverse-3d": 5, "rot-inv-2d": 8}


def small(name, **more):
    """A shipped scene with few particles."""
    overrides = {"fluid.particles_per_side": SMALL[name], **{k.replace("__", "."): v for k, v in more.items()}}
    return whirls.Scene(name, overrides)


@pytest.fixture(params=["inverse-2d", "inverse-3d"])
def scene(request):
    """A scene of each dimension."""
    return small(request.param)
