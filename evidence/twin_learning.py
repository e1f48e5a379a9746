"""What decides whether a policy learns in a twin, one choice at a time.

The ring: whether TRPO learns from the actions that were applied or from the samples beyond their
bounds, and whether it standardises advantages. Eco-driving: whether rewards are centred, which pays
agents for living on, and whether PPO takes smaller steps on more rows. The signal: PPO, and A2C and
DQN, which learn after every episode instead of after four; DQN's recipe `fast` has a smaller
network and half the gradient steps of the paper's (`--only` leaves that out: it is slow).
Everything else is the preset's; each line differs from the first by what it says. Scores are those
of fresh episodes on the context trained on and, in brackets, on the contexts of the others; then
those of each training, and processor seconds of one with its evaluation; for eco-driving also the
sum of rewards of an agent's life.

example: python evidence/twin_learning.py --cmdp ring-acc     # ten minutes of a core
"""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean
from typing import Any

import measure
from learning import trainings
from measure import digits, now

WAYS: dict[str, dict[str, dict[str, Any]]] = {
    "ring-acc": {
        "as it is": {},
        "samples": {"clip_actions": False},
        "standardised": {"normalize_advantage": True},
        "samples, standardised": {"clip_actions": False, "normalize_advantage": True},
    },
    "eco-inflow": {
        "as it is": {},
        "centred rewards": {"center_reward": True},
        "smaller steps, more rows": {
            "rows": 8000,
            "minibatches": 32,
            "n_epochs": 10,
            "learning_rate": 3e-4,
            "clip_range": 0.1,
            "target_kl": 0.02,
        },
    },
    "signal-inflow": {
        "PPO": {},
        "A2C": {"algorithm": "A2C", "recipe_name": "fast"},
        "DQN": {"algorithm": "DQN", "recipe_name": "fast"},
        "DQN of the paper": {"algorithm": "DQN", "recipe_name": "paper"},
    },
}
CONTEXTS = {
    "ring-acc": (2.0, 10.0, 20.0, 30.0, 40.0),
    "eco-inflow": (400.0, 1600.0),
    "signal-inflow": (1000.0, 2000.0),
}


def life(trainer: Any, policy: Any, context: Any) -> tuple[float, float]:
    """(score, sum of rewards of an agent) of 32 episodes; without a policy nobody is controlled."""
    import jax
    import jax.numpy as jnp

    from mbtl.engine.learners import networks
    from mbtl.engine.learners.episodic.episodes import import_actor

    twin, params = trainer.problem([context])
    params = jax.tree.map(lambda x: x[0], params)

    def moved_from(state: Any, obs: Any) -> Any:
        if policy is None:
            return twin.drive(state, params)
        network = jax.tree.map(lambda x: x[0], import_actor([policy]).network)
        outputs = networks.apply(network, obs, policy.activation)
        return twin.step(state, networks.mode(outputs, twin.action), params)

    def one(_: int, carry: Any) -> Any:
        state, rewards, lives = carry
        seen = twin.observe(state, params)
        moved = moved_from(state, seen.obs)
        rewards += jnp.where(seen.acting, moved.reward, 0.0).sum()
        return moved.state, rewards, lives + (moved.done & seen.acting).sum()

    first = (twin.start(jnp.arange(32, dtype=jnp.uint32), params), jnp.float32(0.0), jnp.int32(0))
    played = jax.jit(lambda: jax.lax.fori_loop(0, twin.decisions(params), one, first))
    state, rewards, lives = played()
    return float(twin.score(state).mean()), float(rewards) / max(int(lives), 1)


def way(trainer: Any, changes: dict[str, Any]) -> Any:
    """The trainer with other hyper-parameters, or with another algorithm and its own."""
    if "algorithm" in changes:
        return replace(trainer, **changes, hyperparameters={}, eval_episodes=8)
    settings = {**trainer.hyperparameters, **changes}
    return replace(trainer, hyperparameters=settings, eval_episodes=8)


def main() -> None:
    """Train, evaluate and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--cmdp", choices=tuple(WAYS), default="ring-acc")
    parser.add_argument("--seeds", type=int, default=2, help="trainings per way and context")
    parser.add_argument("--only", nargs="+", help="some of the ways, by name")
    args = parser.parse_args()
    from mbtl.problems import get_cmdp

    score = "paper" if args.cmdp.startswith(("eco", "signal")) else None
    cmdp = get_cmdp(args.cmdp, engine="jax", score=score)
    trainer = cmdp.trainer_for()
    (axis,) = (axis.name for axis in cmdp.space.axes)
    contexts = [{axis: value} for value in CONTEXTS[args.cmdp]]
    eco = args.cmdp.startswith("eco")
    document: dict[str, Any] = {"cmdp": args.cmdp, "episodes": trainer.episodes, "ways": {}}
    lines = [f"{args.cmdp}, {trainer.episodes} episodes, score by context trained on"]
    for name in args.only or WAYS[args.cmdp]:
        changed = way(trainer, WAYS[args.cmdp][name])
        begin, own, others, lives = now(), [], [], []
        for done in trainings(name, changed, contexts, args.seeds):
            own.append(done.own)
            others.append(done.others)
            if eco:
                lives.append(life(changed, done.policy, done.context)[1])
        seconds = digits((now() - begin).cpu / len(own))
        each = [digits(x, 3) for x in own]
        found = {"own": each, "others": [digits(x, 3) for x in others], "rewards": lives}
        found["seconds"] = [seconds]
        document["ways"][name] = found
        rows = " ".join(f"{x:.2f}" for x in each)
        if lives:
            rows += "   rewards per life " + " ".join(f"{x:.0f}" for x in lives)
        lines.append(
            f"{name:25} {fmean(own):6.2f} ({fmean(others):.2f})   {rows}   {seconds:g} s each"
        )
    if eco:
        alone = [life(trainer, None, context) for context in contexts]
        document["uncontrolled"] = alone
        rows = " ".join(f"{score:.2f}" for score, _ in alone)
        rows += "   rewards per life " + " ".join(f"{rewards:.0f}" for _, rewards in alone)
        lines.append(f"{'uncontrolled':42} {rows}")
    document["machine"] = measure.machine("jax")
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
