import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput, StorageError
from mbtl.objective import Bounds
from mbtl.portfolio import DiscreteHead, MLPPolicy, Portfolio, load_portfolio

SPACE = ContextSpace.grid({Linear("length", 0.5, 2.5, "m"): 5})
RETURNS = np.array([[500.0, 400, 200, 100, 0], [0, 100, 300, 450, 500]])


def constant(action):
    """A policy that always takes one action of two."""
    zeros = np.zeros((2, 1), dtype=np.float32)
    bias = np.eye(2, dtype=np.float32)[action]
    return MLPPolicy((zeros,), (bias,), "tanh", (1,), DiscreteHead((2,)))


def make(**changes):
    settings = {
        "space": SPACE,
        "sources": (0, 4),
        "returns": RETURNS,
        "bounds": Bounds(0, 500),
        "policy_format": "mlp",
        "in_memory": {0: constant(0), 1: constant(1)},
        "cmdp": "cartpole-length",
        "metadata": {"note": "test"},
    }
    return Portfolio(**{**settings, **changes})


def act(policy):
    return int(policy.predict(np.zeros(1))[0])


# ---- routing -------------------------------------------------------------------------------------


def test_every_context_gets_the_policy_that_returned_most_there():
    portfolio = make()
    assert portfolio.routing.route.tolist() == [0, 0, 1, 1, 1]
    assert portfolio.value == pytest.approx((500 + 400 + 300 + 450 + 500) / 5 / 500)
    assert repr(portfolio).endswith(", V = 0.8600, estimated)")  # a report measures it afresh
    assert act(portfolio.policy_for({"length": 0.5})) == 0
    assert act(portfolio.policy_for({"length": 2.5})) == 1


def test_choice_on_the_list_explains_itself():
    choice = make().explain({"length": 1.0})
    assert (choice.policy, choice.source, choice.source_context) == (0, 0, {"length": 0.5})
    assert (choice.predicted_return, choice.basis) == (400.0, "observed")
    assert (choice.runner_up, choice.margin) == (1, 300.0)
    assert (choice.error, choice.margin_error) == (None, None)  # nobody knows, from one episode
    assert choice.explanation == (
        "Policy 1, trained on length = 0.5 m, should return about 400 (its error is unknown): it "
        "was evaluated here; policy 2 is 300 behind, which may be chance."
    )


def played(returns, deviation, count=10):
    """Episodes with these means and deviations, whose luck no two entries share."""
    luck = np.random.default_rng(1).standard_normal((*np.shape(returns), count))
    luck -= luck.mean(axis=-1, keepdims=True)
    return list(np.asarray(returns)[..., None] + deviation * luck / luck.std(-1, ddof=1)[..., None])


def test_explanations_have_error_bars_and_say_where_noise_decides():
    sure = make(episodes=played(RETURNS, 1.0)).explain({"length": 1.0})
    assert "the next best, policy 2, is " in sure.explanation
    rng = np.random.default_rng(0)
    noisy = np.array([[300.0], [301.0]]) + 40.0 * rng.standard_normal((2, 5))
    portfolio = make(returns=noisy, episodes=played(noisy, 126.0))
    choice = portfolio.explain({"length": 1.0})
    assert choice.margin < 1.96 * choice.margin_error
    assert choice.explanation.endswith("may do as well: the difference is within the noise.")
    assert portfolio.routing.value.error > 0


@pytest.mark.parametrize("shared", [(), ("policies",)])
def test_nine_of_ten_returns_lie_where_explain_says_whoever_shares_the_episodes(shared):
    """Three episodes of scatter 300: of every entry, or of every context."""
    n, sources = 20, (2, 7, 12, 17)
    space = ContextSpace.grid({Linear("x", 0.0, 1.0): n})
    x = np.linspace(0.0, 1.0, n)
    truth = np.array([-200.0 - 1000.0 * np.abs(x[s] - x) - 200.0 * x for s in sources])
    size = (1 if shared else 4, n, 3)
    held, lead_held = [], []
    for seed in range(20):
        noise = 300.0 * np.random.default_rng(seed).standard_normal(size)
        episodes = truth[:, :, None] + np.broadcast_to(noise, (4, n, 3))
        portfolio = Portfolio(
            space, sources, episodes.mean(axis=2), Bounds(-1600.0, 0.0), episodes=list(episodes)
        )
        for target in range(seed % 4, n, 4):
            choice = portfolio.explain(space.context(target))
            true = truth[choice.policy, target]
            off = abs(choice.predicted_return - true)
            held.append(off <= 1.96 * choice.error)
            lead = true - truth[choice.runner_up, target]
            lead_held.append(abs(choice.margin - lead) <= 1.96 * choice.margin_error + 1e-6)
    assert np.mean(held) > 0.88
    assert np.mean(lead_held) > 0.88


def test_what_all_policies_share_is_in_a_return_and_not_in_a_lead():
    n = 12  # rows without any luck of their own, of nine episodes with much that they share
    space = ContextSpace.grid({Linear("x", 0.0, 1.0): n})
    returns = np.array([450.0 - 25.0 * abs(source - np.arange(n)) for source in (2, 9)])
    luck = played(np.zeros((1, n)), 90.0, 9)[0]
    episodes = [row[:, None] + luck for row in returns]
    portfolio = Portfolio(space, (2, 9), returns, Bounds(0.0, 500.0), episodes=episodes)
    choice = portfolio.explain(space.context(2))
    assert 10.0 < choice.error < 36.0  # 30 by its own episodes alone
    assert choice.margin == pytest.approx(175.0, abs=1.0)
    assert choice.margin_error < 0.1 * choice.error
    # contexts are independent: V is surer by the root of their number, whoever shares
    student = 1.984  # about 100 degrees of freedom
    assert portfolio.routing.value.margin == pytest.approx(student * 30.0 / n**0.5 / 500, rel=0.15)


def test_exact_returns_are_exact_on_the_list_and_anything_between_those_around_elsewhere():
    portfolio = make(episodes=played(RETURNS, 0.0, 9))
    listed, between = portfolio.explain({"length": 1.0}), portfolio.explain({"length": 1.25})
    assert (listed.error, listed.margin_error) == (0.0, 0.0)
    assert between.error == pytest.approx(200.0 / np.sqrt(12.0))  # 400 and 200, evenly
    assert "should return about 300 +- 113, judging by the nearest" in between.explanation
    same = make(returns=np.full((2, 5), 300.0), episodes=played(np.full((2, 5), 300.0), 0.0, 9))
    agreed = same.explain({"length": 1.25})
    assert (agreed.error, agreed.margin_error) == (None, None)
    assert "should return about 300 (its error is unknown)" in agreed.explanation


def test_a_context_without_evaluation_is_predicted_and_says_so():
    returns = np.full((1, 5), np.nan)
    returns[0, :2] = 400.0, 300.0
    choice = make(sources=(0,), returns=returns, in_memory={}).explain({"length": 1.5})
    assert choice.basis == "predicted"
    assert 0.0 < choice.predicted_return < 400.0
    assert choice.error > 0.0
    assert "it was not evaluated here, the transfer model predicts it" in choice.explanation
    assert choice.explanation.endswith("no other policy can be compared.")


def test_smaller_is_better_when_the_bounds_say_so():
    portfolio = make(bounds=Bounds(0, 500, "minimize"))
    assert portfolio.routing.route.tolist() == [1, 1, 0, 0, 0]
    choice = portfolio.explain({"length": 1.25})
    assert (choice.policy, choice.predicted_return) == (1, pytest.approx(200.0))
    assert choice.margin == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"returns": RETURNS[:1]}, r"returns of shape \(1, 5\)"),
        ({"sources": (0, 5)}, r"sources \(0, 5\)"),
        ({"sources": (), "returns": np.empty((0, 5))}, "one or more policies"),
        ({"sets": {2: (0,)}}, r"sets \{2: \(0,\)\}"),
        ({"returns": RETURNS - np.inf}, "returns must be within"),
        ({"returns": np.full((2, 5), np.nan)}, "return of at least one"),
        ({"episodes": [np.zeros((5, 2))]}, r"shapes \[\(5, 2\)\]"),
        ({"episodes": [np.zeros((5, 2)), np.zeros((5, 0))]}, r"shapes \[\(5, 2\), \(5, 0\)\]"),
        ({"policy_folders": (None,)}, "1 folders"),
    ],
)
def test_parts_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(InvalidInput, match=message):
        make(**changes)


def test_policies_are_loaded_once_and_only_when_needed(tmp_path):
    asked = []

    def load(folder):
        asked.append(folder.name)
        return constant(1)

    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
    portfolio = make(in_memory={}, policy_folders=folders, policy_format="custom", load=load)
    portfolio.policy_for({"length": 2.5})
    portfolio.policy_for({"length": 2.4})
    assert asked == ["b"]


# ---- files ---------------------------------------------------------------------------------------


def test_saved_portfolio_is_the_same_portfolio(tmp_path):
    episodes = [played(RETURNS[:1], 9.0, 3)[0], played(RETURNS[1:], 9.0, 4)[0]]
    portfolio = make(episodes=episodes, risk=0.5)
    again = load_portfolio(portfolio.save(tmp_path / "p"))
    assert again.space == portfolio.space
    assert np.array_equal(again.returns, portfolio.returns)
    assert all(np.array_equal(one, two) for one, two in zip(again.episodes, episodes, strict=True))
    assert again.risk == 0.5
    assert (again.sources, again.bounds) == ((0, 4), Bounds(0, 500))
    assert (again.cmdp, again.metadata) == ("cartpole-length", {"note": "test"})
    assert [act(again.policy(i)) for i in range(2)] == [0, 1]
    policies = sorted(path.name for path in (tmp_path / "p" / "policies").iterdir())
    assert policies == ["source-0000", "source-0004"]
    assert [p.name for p in tmp_path.iterdir()] == ["p"]  # nothing half-built is left beside it


def test_manifest_lists_every_file_with_its_hash(tmp_path):
    folder = make().save(tmp_path / "p")
    manifest = json.loads((folder / "portfolio.json").read_text())
    found = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "portfolio.json"
    }
    assert manifest["files"] == found
    assert (manifest["format"], manifest["versions"]["numpy"]) == (2, np.__version__)


def test_trained_folders_are_copied_and_outlive_the_study(tmp_path):
    kept = tmp_path / "study" / "source-0000"
    kept.mkdir(parents=True)
    (kept / "theta.txt").write_text("7")
    portfolio = make(
        sources=(0, 0), policy_folders=(kept, kept), in_memory={}, policy_format="custom"
    )
    folder = portfolio.save(tmp_path / "p")
    (kept / "theta.txt").unlink()
    kept.rmdir()
    again = load_portfolio(folder, load=lambda place: (place / "theta.txt").read_text())
    assert [again.policy(0), again.policy(1)] == ["7", "7"]
    policies = sorted(path.name for path in (folder / "policies").iterdir())
    assert policies == ["source-0000", "source-0000-2"]
    with pytest.raises(InvalidInput, match="pass load="):
        load_portfolio(folder).policy(0)
    with pytest.raises(StorageError, match="moved or deleted"):
        portfolio.save(tmp_path / "q")
    assert not (tmp_path / "q").exists()


def test_policy_that_was_not_saved_says_so(tmp_path):
    unsaved = make(in_memory={0: object()}, policy_format="custom")
    with pytest.raises(StorageError, match="allow_missing=True"):
        unsaved.save(tmp_path / "p")
    folder = unsaved.save(tmp_path / "p", allow_missing=True)
    again = load_portfolio(folder)
    assert again.explain({"length": 0.5}).policy == 0  # routing still works
    with pytest.raises(
        StorageError, match=r"trained on length = 0.5 m\) was not saved.*policy_obj"
    ):
        again.policy(0)


def test_changed_and_missing_files_are_named(tmp_path):
    folder = make().save(tmp_path / "p")
    weights = folder / "policies" / "source-0004" / "weights.npz"
    weights.write_bytes(weights.read_bytes() + b"x")
    changed = r"policies/source-0004/weights.npz .* must be as it was saved"
    with pytest.raises(StorageError, match=changed):
        load_portfolio(folder)
    weights.unlink()
    with pytest.raises(StorageError, match=r"weights\.npz, which is missing"):
        load_portfolio(folder)
    with pytest.raises(StorageError, match="without it"):
        load_portfolio(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 3}, "formats up to 2"),
        ({"kind": "else"}, "must describe a portfolio"),
        ({"bounds": {"low": 1, "high": 0}}, "must fit each other"),
        ({"sources": [0]}, "must fit each other"),
        ({"policies": None}, "whole portfolio"),
    ],
)
def test_manifest_that_cannot_be_used(tmp_path, change, message):
    folder = make().save(tmp_path / "p")
    path = folder / "portfolio.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(StorageError, match=message):
        load_portfolio(folder)


def test_an_existing_folder_is_replaced_only_when_asked(tmp_path):
    folder = make().save(tmp_path / "p")
    other = make(sources=(1, 3))
    with pytest.raises(InvalidInput, match="overwrite=True"):
        other.save(folder)
    other.save(folder, overwrite=True)
    assert load_portfolio(folder).sources == (1, 3)
    load_portfolio(folder).save(folder, overwrite=True)  # from itself: its policies lie inside
    assert act(load_portfolio(folder).policy(1)) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["p"]
    (tmp_path / "empty").mkdir()
    assert load_portfolio(make().save(tmp_path / "empty")).sources == (0, 4)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("meow")
    with pytest.raises(InvalidInput, match="a folder of its own"):
        make().save(tmp_path / "photos", overwrite=True)


def test_save_that_fails_half_way_leaves_the_old_portfolio(tmp_path, monkeypatch):
    folder = make().save(tmp_path / "p")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mbtl.files.os.fsync", full)
    with pytest.raises(StorageError, match="No space left on device"):
        make(sources=(1, 3)).save(folder, overwrite=True)
    assert load_portfolio(folder).sources == (0, 4)
    assert [p.name for p in tmp_path.iterdir()] == ["p"]


def test_metadata_must_be_json(tmp_path):
    with pytest.raises(InvalidInput, match="JSON-able"):
        make(metadata={"f": print}).save(tmp_path / "p")
    folder = make(metadata={"n": np.int64(3), "v": np.array([1.5])}).save(tmp_path / "p")
    assert load_portfolio(folder).metadata == {"n": 3, "v": [1.5]}


def test_portfolio_of_numpy_policies_needs_no_rl_library(tmp_path):
    folder = make().save(tmp_path / "p")
    script = (
        "import sys, numpy\n"
        "from mbtl.portfolio import load_portfolio\n"
        f"policy = load_portfolio({str(folder)!r}).policy_for({{'length': 2.0}})\n"
        "assert int(policy.predict(numpy.zeros(1))[0]) == 1\n"
        "heavy = {'torch', 'gymnasium', 'stable_baselines3', 'jax'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
