"""Ranges of Isaac Lab's and mjlab's event terms as axes, and back into a config.

Isaac Lab needs a GPU's simulator, so its configs are dataclasses of the same shape here; mjlab's
own are used where it is installed.
"""

import dataclasses
import math
import re
from functools import partial
from types import SimpleNamespace

import blocks
import pytest

import mbtl
from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.randomisation import axes_of, pinned, space_of


@dataclasses.dataclass
class Term:
    mode: str
    params: dict
    func: object = dataclasses.field(default_factory=lambda: dataclasses.MISSING)


@pytest.fixture
def cfg():
    """Terms as they stand in tasks: locomotion, a hand (gravity), mjlab's friction."""
    shared = {"x": (-0.5, 0.5), "yaw": [0.0, 0.0]}
    gravity = {"gravity_distribution_params": ([0.0, 0.0, 0.0], [0.0, 0.0, 0.4])}
    friction = {"axes": [0, 1], "ranges": (1e-4, 1e-2)}
    events = SimpleNamespace(
        material=Term("startup", {"static_friction_range": (0.3, 1.2), "num_buckets": 64}),
        base_com=Term("startup", {"ranges": {0: (-0.1, 0.1), 1: (-0.2, 0.2)}}),
        reset_base=Term("reset", {"pose_range": {}, "velocity_range": shared}),
        push=Term("interval", {"velocity_range": shared}),
        gravity=Term("interval", {**gravity, "operation": "add", "distribution": "gaussian"}),
        spin=Term("reset", {**friction, "distribution": SimpleNamespace(name="log_uniform")}),
        reset_all=Term("reset", {}),
        nothing=None,
    )
    return SimpleNamespace(events=events, decimation=4)


def test_each_range_that_varies_is_an_axis(cfg):
    assert axes_of(cfg) == [
        mbtl.Linear("material.static_friction_range", 0.3, 1.2),
        mbtl.Linear("base_com.ranges[0]", -0.1, 0.1),
        mbtl.Linear("base_com.ranges[1]", -0.2, 0.2),
        mbtl.Linear("reset_base.velocity_range.x", -0.5, 0.5),
        mbtl.Linear("push.velocity_range.x", -0.5, 0.5),
        mbtl.Linear("gravity.gravity_distribution_params[2]", -0.8, 0.8),
        mbtl.Log("spin.ranges", 1e-4, 1e-2),
    ]
    assert axes_of(cfg) == axes_of(cfg.events) == axes_of(vars(cfg.events))
    assert axes_of(cfg, ["spin", "base_com.ranges[1]"]) == [axes_of(cfg)[2], axes_of(cfg)[6]]
    assert space_of(cfg, "spin", values=3).values("spin.ranges")[1] == pytest.approx(1e-3)


def test_a_pinned_config_has_the_value_of_the_context_alone(cfg):
    before = repr(cfg)
    made = pinned(cfg, {axis.name: axis.spread(5)[1] for axis in axes_of(cfg)})
    assert repr(cfg) == before
    it = made.events
    assert it.material.params["static_friction_range"] == pytest.approx((0.525, 0.525))
    assert it.base_com.params["ranges"] == {0: (-0.05, -0.05), 1: (-0.1, -0.1)}
    assert it.gravity.params["gravity_distribution_params"] == ([0, 0, -0.4], [0, 0, 0])
    assert it.spin.params["ranges"] == pytest.approx((10**-3.5, 10**-3.5))
    assert it.spin.params["axes"] == [0, 1]
    assert it.material.func is dataclasses.MISSING
    with pytest.raises(InvalidInput, match=r"one value already"):
        space_of(made)


def test_only_what_a_context_names_is_pinned(cfg):
    made = pinned(cfg, {"push.velocity_range.x": 0.25}).events
    assert made.push.params == {"velocity_range": {"x": (0.25, 0.25), "yaw": [0.0, 0.0]}}
    assert made.reset_base == cfg.events.reset_base  # which shares the dict of the push
    assert (made.push.mode, made.gravity.mode) == ("interval", "interval")
    made = pinned(cfg, {"gravity.gravity_distribution_params[2]": 0.0}).events
    assert made.gravity.mode == "reset"  # it would begin after an interval


def test_what_is_wrong_is_said(cfg):
    rewards, pin = {"alive": SimpleNamespace(params={}, weight=1.0)}, partial(pinned, cfg)
    for error, words, call, *given in (
        (UnknownName, "Did you mean 'material'", axes_of, cfg, ["mater"]),
        (UnknownName, "more than one value.*'reset_all'", axes_of, cfg, ["reset_all"]),
        (InvalidInput, "7 ranges of 30 values.*by `only`", partial(space_of, values=30), cfg),
        (UnknownName, "Did you mean 'material.static", pin, {"material.friction": 1.0}),
        (ContextMismatch, "takes values in .*, got 9.0", pin, {"spin.ranges": 9.0}),
        (InvalidInput, "event terms", axes_of, rewards),
        (InvalidInput, "event terms", axes_of, type(cfg)),
    ):
        with pytest.raises(error, match=words):
            call(*given)
    for bad in ((-1.0, 1.0, 0), (0.0, math.inf), ("low", "high"), (2, 1), ([0], [1, 2])):
        cfg.events.spin.params["ranges"] = bad  # the first stands in Isaac Lab 2.3's tasks
        with pytest.raises(InvalidInput, match=r"spin.ranges needs two finite numbers"):
            axes_of(cfg)
        assert len(axes_of(cfg, ["material"])) == 1
    cfg.events.spin.params.update(ranges=(1.0, 2.0), distribution="beta")
    with pytest.raises(UnknownName, match=r"distribution of spin.ranges is called 'beta'"):
        axes_of(cfg)


# ---- mjlab ---------------------------------------------------------------------------------------


def test_every_task_of_mjlab_can_be_pinned():
    registry = pytest.importorskip("mjlab.tasks.registry")
    for task in registry.list_tasks():
        cfg = registry.load_env_cfg(task)
        before, axes = repr(cfg), axes_of(cfg)
        made = pinned(cfg, {axis.name: axis.spread(3)[1] for axis in axes})
        assert (len(axes) > 2, axes_of(made), repr(cfg)) == (True, [], before)


@pytest.mark.long
def test_the_study_of_the_page_runs_and_contexts_are_in_the_model():
    pytest.importorskip("mjlab")
    page = (blocks.ROOT / "docs" / "domain-randomisation.md").read_text("utf-8")
    [code] = [c for c in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "mjlab" in c]
    names, shorter = {}, {"cuda:0": "cpu", "1024": "2", "(300)": "(1)"}
    exec(re.sub("|".join(map(re.escape, shorter)), lambda it: shorter[it[0]], code), names)
    names["cfg"].episode_length_s = 0.2
    for context in names["space"].contexts[::4]:
        env = names["env_of"](context, 0).unwrapped
        env.reset()
        robot = env.scene["robot"]
        feet = [i for i, name in enumerate(robot.geom_names) if "foot_collision" in name]
        friction = env.sim.model.geom_friction[:, robot.indexing.geom_ids[feet], 0]
        assert friction.numpy() == pytest.approx(context["foot_friction_slide.ranges"])
    study = mbtl.create_study(names["problem"], budget=2)
    study.run()
    assert math.isfinite(study.value)
