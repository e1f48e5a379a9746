"""BipedalWalker: Gymnasium's in the nominal context, and contexts that act."""

import numpy as np
import pytest
from played import begun, played

from mbtl.errors import ContextMismatch, InvalidInput
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.locomotion import walker
from mbtl.zoo.cmdps.locomotion.walker import BipedalWalker, Constants, Walker, advance

ROUGH = walker.ROUGH
N_LUCK = ROUGH + walker.PATCHES + 1
NOMINAL = Constants(10.0, 2.5, 30.0)


class Drawn:
    """Gymnasium's generator, which draws what one of our walkers is given; no clouds."""

    def __init__(self, luck):
        self._slopes, self._patches, self._push = iter(luck[:ROUGH]), iter(luck[ROUGH:-1]), luck[-1]

    def uniform(self, low, high):
        share = next(self._slopes) if (low, high) == (-1, 1) else self._push if low == -high else 0
        return low + (high - low) * share

    def integers(self, low, high):
        return low + int((high - low) * next(self._patches))


@pytest.mark.parametrize(("seed", "acting"), [(1, "heuristic"), (2, "heuristic"), (3, "random")])
def test_in_the_nominal_context_it_is_gymnasium_s_step_for_step(seed, acting):
    pytest.importorskip("pygame", reason="Gymnasium's environment imports it")
    theirs = pytest.importorskip("gymnasium.envs.box2d.bipedal_walker")
    rng = np.random.default_rng(seed)
    luck = rng.random(N_LUCK)
    peer, walker = theirs.BipedalWalker(), Walker(NOMINAL, luck)
    peer.np_random = Drawn(luck)
    expected, _ = peer.reset()
    seen, _, _ = advance([walker], np.zeros((1, 4), np.float32))
    heuristic, ended = theirs.BipedalWalkerHeuristics(), False
    heuristic.a = np.zeros(4)
    for _ in range(300):
        np.testing.assert_array_equal(seen[0], expected)
        wanted = heuristic.step_heuristic(expected) if acting == "heuristic" else 3 * rng.random(4)
        action = np.asarray(wanted, np.float32) - (1.5 if acting == "random" else 0.0)
        expected, reward, ended, _, _ = peer.step(action)
        seen, rewards, over = advance([walker], action[None])
        assert rewards[0] == pytest.approx(reward, abs=1e-5)
        assert over[0] == ended
        if ended:
            break
    np.testing.assert_array_equal(seen[0], expected)


def test_walkers_stepped_together_are_those_stepped_alone():
    rng = np.random.default_rng(0)
    contexts = [NOMINAL, Constants(2.0, 0.5, 10.0), Constants(20.0, 10.0, 90.0)]
    lucks, actions = rng.random((3, N_LUCK)), rng.uniform(-1, 1, (40, 3, 4)).astype(np.float32)
    herd = [Walker(*own) for own in zip(contexts, lucks, strict=True)]
    together = [advance(herd, action) for action in actions]
    for i, own in enumerate(zip(contexts, lucks, strict=True)):
        walker = Walker(*own)
        for k, action in enumerate(actions):
            for alone, all_of in zip(advance([walker], action[[i]]), together[k], strict=True):
                np.testing.assert_array_equal(alone[0], all_of[i])


def test_scale_divides_hull_and_roughness_and_the_worth_of_the_way():
    luck = np.random.default_rng(0).random(N_LUCK)
    fine, coarse = (Walker(NOMINAL._replace(scale=scale), luck) for scale in (60.0, 30.0))
    assert coarse.bodies[0].mass == pytest.approx(4 * fine.bodies[0].mass, rel=1e-5)
    assert coarse.bodies[1].mass == fine.bodies[1].mass
    rough = [np.ptp(walker.heights(luck, scale)) for scale in (30.0, 3000.0)]
    assert rough[0] > 10 * rough[1]
    moved = [advance([walker], np.zeros((1, 4), np.float32)) for walker in (fine, coarse)]
    assert [one[1][0] for one in moved] == [0.0, 0.0]
    assert coarse.progress == pytest.approx(2 * fine.progress, rel=1e-2)


def test_a_walker_that_falls_loses_a_hundred_and_the_episode():
    env = begun(BipedalWalker())
    action = np.array([1.0, 1.0, -1.0, -1.0])
    _, reward, _, truncated, _ = played(lambda: env.step(action))[-1]
    assert (reward, truncated) == (-100.0, False)
    with pytest.raises(InvalidInput, match="reset"):
        env.step(action)


def test_unguided_it_stands_still_at_little_cost():
    env = begun(BipedalWalker())
    steps = [env.drive() for _ in range(1000)]
    assert [step[2] for step in steps] == [False] * 1000
    assert -20 < sum(step[1] for step in steps) < 0


def test_an_action_that_is_no_number_gives_none():
    env = begun(BipedalWalker())
    seen, reward, ended, _, _ = env.step([np.nan, 0.0, 0.0, 0.0])
    assert np.isnan(seen[:24]).all()
    assert np.isnan(reward)
    assert ended


@pytest.mark.parametrize(
    "context", [{"scale": 0.0}, {"friction": -1.0}, {"gravity": float("nan")}, {"scale": 1e9}]
)
def test_a_context_that_no_walker_can_have_is_refused(context):
    with pytest.raises(ContextMismatch, match=next(iter(context))):
        BipedalWalker(context).reset(seed=0)


@pytest.mark.parametrize(
    ("axis", "paper"),
    [("gravity", (1.0, 100.0)), ("friction", (0.25, 25.0)), ("scale", (3.0, 300.0))],
)
def test_the_grid_of_the_paper_s_text_is_another_one(axis, paper):
    stated = get_cmdp(f"walker-{axis}", grid="paper").space.values(axis)
    assert (len(stated), stated[0], stated[-1]) == (100, *paper)
    for edge in paper:
        BipedalWalker({axis: edge}).reset(seed=0)
