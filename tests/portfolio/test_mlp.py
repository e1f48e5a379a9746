import json

import numpy as np
import pytest

from mbtl.errors import InvalidInput, StorageError
from mbtl.portfolio import BoxHead, DiscreteHead, MLPPolicy


def f32(values):
    return np.asarray(values, dtype=np.float32)


def relu_policy(head=None):
    """outputs = relu(x) + 1, relu(-x): a network small enough to work out by hand."""
    return MLPPolicy(
        weights=(f32([[1], [-1]]), f32([[1, 0], [0, 1]])),
        biases=(f32([0, 0]), f32([1, 0])),
        activation="relu",
        observation_shape=(1,),
        head=head or DiscreteHead((2,)),
    )


def linear(weight, bias, head):
    """Outputs are weight x + bias."""
    return MLPPolicy((f32(weight),), (f32(bias),), "tanh", (1,), head)


def box_policy(**options):
    return linear([[1], [2]], [0, 0], BoxHead(f32([-1, 0]), f32([1, 10]), **options))


def test_outputs_of_a_network_worked_out_by_hand():
    assert relu_policy().outputs(f32([[2.0], [-3.0]])).tolist() == [[3.0, 0.0], [1.0, 3.0]]


BLOCKS = linear(np.zeros((5, 1)), [0, 1, 5, 9, 7], DiscreteHead((2, 3), scalar=False))


@pytest.mark.parametrize(
    ("policy", "observation", "action"),
    [
        (relu_policy(), [-3.0], 1),
        (relu_policy(), [[2.0], [-3.0]], [0, 1]),
        (BLOCKS, [0.0], [1, 1]),  # the largest of each block
        (box_policy(), [3.0], [1.0, 6.0]),  # clipped to the box
        (box_policy(), [-3.0], [-1.0, 0.0]),
        (box_policy(squash=True), [0.5], [np.tanh(0.5), 5.0 * (np.tanh(1.0) + 1.0)]),
    ],
)
def test_the_action_is_the_best_of_the_outputs(policy, observation, action):
    found, state = policy.predict(f32(observation))
    assert state is None
    assert found == pytest.approx(np.asarray(action), abs=1e-6)
    assert found.dtype == (np.float32 if isinstance(policy.head, BoxHead) else np.int64)


COIN = linear([[0], [0]], [np.log(3), 0], DiscreteHead((2,)))  # three times as likely 0 as 1
GAUSS = linear([[1]], [0], BoxHead(f32([-9]), f32([9]), log_std=f32([np.log(0.5)])))


@pytest.mark.parametrize(
    ("policy", "mean", "std"), [(COIN, 0.25, np.sqrt(0.1875)), (GAUSS, 2.0, 0.5)]
)
def test_samples_follow_their_distribution(policy, mean, std):
    observations = f32(np.full((4000, 1), 2.0))
    actions, _ = policy.predict(observations, deterministic=False, rng=np.random.default_rng(0))
    assert (actions.mean(), actions.std()) == pytest.approx((mean, std), abs=0.04)


def test_sampling_needs_a_generator_and_a_distribution():
    with pytest.raises(InvalidInput, match="rng"):
        relu_policy().predict(f32([1.0]), deterministic=False)
    for policy in (box_policy(), relu_policy(DiscreteHead((2,), samples=False))):
        with pytest.raises(InvalidInput, match="no action distribution"):
            policy.predict(f32([1.0]), deterministic=False, rng=np.random.default_rng(0))


def test_action_does_not_depend_on_the_rest_of_the_batch():
    rng = np.random.default_rng(1)
    shapes = [(64, 3), (64, 64), (2, 64)]
    head = BoxHead(f32([-1, -1]), f32([1, 1]))
    weights = tuple(f32(rng.normal(size=s) / 8) for s in shapes)
    policy = MLPPolicy(weights, tuple(f32(np.zeros(s[0])) for s in shapes), "tanh", (3,), head)
    batch = f32(rng.normal(size=(200, 3)))
    whole = policy.predict(batch)[0]
    assert np.array_equal(whole, np.stack([policy.predict(o)[0] for o in batch]))
    assert np.array_equal(whole[50:57], policy.predict(batch[50:57])[0])


@pytest.mark.parametrize(
    "policy", [relu_policy(), box_policy(squash=True), box_policy(log_std=f32([0, 1]))]
)
def test_saved_policy_acts_as_before(policy, tmp_path):
    policy.save(tmp_path)
    again = MLPPolicy.load(tmp_path)
    batch = f32([[-2.0], [0.1], [3.0]])
    assert np.array_equal(again.predict(batch)[0], policy.predict(batch)[0])
    log_std = getattr(policy.head, "log_std", None)
    assert (getattr(again.head, "log_std", None) is None) == (log_std is None)


def test_layers_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInput, match="layers must lead from 1 inputs to 2 outputs"):
        linear([[1, 1]], [0], DiscreteHead((2,)))
    with pytest.raises(InvalidInput, match="activation must be"):
        MLPPolicy((f32([[1], [1]]),), (f32([0, 0]),), "selu", (1,), DiscreteHead((2,)))
    with pytest.raises(InvalidInput, match=r"shape \(1,\), alone or as a batch, got \(3,\)"):
        relu_policy().predict(f32([1, 2, 3]))


def test_a_newer_format_is_named(tmp_path):
    relu_policy().save(tmp_path)
    record = json.loads((tmp_path / "policy.json").read_text())
    (tmp_path / "policy.json").write_text(json.dumps({**record, "format": 99}))
    with pytest.raises(StorageError, match="install a newer mbtl"):
        MLPPolicy.load(tmp_path)
