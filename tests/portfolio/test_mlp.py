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


def box_policy(**options):
    head = BoxHead(f32([-1, 0]), f32([1, 10]), **options)
    return MLPPolicy((f32([[1], [2]]),), (f32([0, 0]),), "tanh", (1,), head)


def test_outputs_of_a_network_worked_out_by_hand():
    assert relu_policy().outputs(f32([[2.0], [-3.0]])).tolist() == [[3.0, 0.0], [1.0, 3.0]]


def test_discrete_action_is_the_largest_output_alone_and_in_a_batch():
    policy = relu_policy()
    single, state = policy.predict(f32([-3.0]))
    assert (int(single), single.shape, state) == (1, (), None)
    assert policy.predict(f32([[2.0], [-3.0]]))[0].tolist() == [0, 1]


def test_multi_discrete_takes_the_largest_of_each_block():
    head = DiscreteHead((2, 3), scalar=False)
    policy = MLPPolicy((f32(np.zeros((5, 1))),), (f32([0, 1, 5, 9, 7]),), "tanh", (1,), head)
    assert policy.predict(f32([0.0]))[0].tolist() == [1, 1]


def test_continuous_mean_is_clipped_to_the_box():
    assert box_policy().predict(f32([3.0]))[0].tolist() == [1.0, 6.0]
    assert box_policy().predict(f32([-3.0]))[0].tolist() == [-1.0, 0.0]


def test_squashed_action_is_stretched_over_the_box():
    action = box_policy(squash=True).predict(f32([0.5]))[0]
    assert action == pytest.approx([np.tanh(0.5), 5.0 * (np.tanh(1.0) + 1.0)], abs=1e-6)
    assert action.dtype == np.float32


def test_samples_follow_the_softmax():
    policy = MLPPolicy((f32([[0], [0]]),), (f32([np.log(3), 0]),), "tanh", (1,), DiscreteHead((2,)))
    observations = f32(np.zeros((4000, 1)))
    actions, _ = policy.predict(observations, deterministic=False, rng=np.random.default_rng(0))
    assert np.mean(actions == 0) == pytest.approx(0.75, abs=0.03)


def test_samples_follow_the_gaussian():
    head = BoxHead(f32([-9]), f32([9]), log_std=f32([np.log(0.5)]))
    policy = MLPPolicy((f32([[1]]),), (f32([0]),), "tanh", (1,), head)
    observations = f32(np.full((4000, 1), 2.0))
    actions, _ = policy.predict(observations, deterministic=False, rng=np.random.default_rng(0))
    assert actions.mean() == pytest.approx(2.0, abs=0.04)
    assert actions.std() == pytest.approx(0.5, abs=0.03)


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
        MLPPolicy((f32([[1, 1]]),), (f32([0]),), "tanh", (1,), DiscreteHead((2,)))
    with pytest.raises(InvalidInput, match="activation must be"):
        MLPPolicy((f32([[1], [1]]),), (f32([0, 0]),), "selu", (1,), DiscreteHead((2,)))
    with pytest.raises(InvalidInput, match=r"shape \(1,\), alone or as a batch, got \(3,\)"):
        relu_policy().predict(f32([1, 2, 3]))


def test_damaged_policy_folders_give_one_clear_error(tmp_path):
    with pytest.raises(StorageError, match=r"whole policy.json and weights.npz"):
        MLPPolicy.load(tmp_path)
    relu_policy().save(tmp_path)
    weights = (tmp_path / "weights.npz").read_bytes()
    (tmp_path / "weights.npz").write_bytes(weights[: len(weights) // 2])
    with pytest.raises(StorageError, match="save the policy again"):
        MLPPolicy.load(tmp_path)


def test_newer_policy_format_is_refused(tmp_path):
    relu_policy().save(tmp_path)
    record = json.loads((tmp_path / "policy.json").read_text())
    (tmp_path / "policy.json").write_text(json.dumps({**record, "format": 99}))
    with pytest.raises(StorageError, match="install a newer mbtl"):
        MLPPolicy.load(tmp_path)


def test_pickled_arrays_are_refused(tmp_path):
    relu_policy().save(tmp_path)
    with (tmp_path / "weights.npz").open("wb") as file:
        np.savez(file, weight_0=np.array([print], dtype=object))
    with pytest.raises(StorageError, match=r"weights\.npz"):
        MLPPolicy.load(tmp_path)
