"""One policy for all contexts of a CMDP: the baselines that train once instead of choosing sources.

    params = stack_params(world, [derive(...) for each context], visible)
    recipe = MultiTaskRecipe(method="paco")
    sets = in_sets(recipe, params, len(params.visible))            # one policy, all contexts
    training = train(world, recipe, [seed], sets, 5_000_000, checkpoint_episodes=...)
    returns = evaluate(world, actor_of(training.best), context_of(sets, 0), seeds)   # (1, N, E)

Methods: `ppo` is context-conditioned PPO, an ordinary policy that reads the context in its
observation; `paco` composes a network per context (`paco.py`); `moore` mixes orthogonal
representations per context (`moore.py`). All three learn by the same PPO from the same rollouts,
in which contexts take turns (`mbtl.engine.worlds.copies`).

The training loop knows these as one more algorithm, so nothing that trains is imported here.
"""
