"""Episodes of an environment, whatever decides on the actions."""


def begun(env, seed=0):
    """The environment, in an episode."""
    env.reset(seed=seed)
    return env


def played(step):
    """What `step()` gives until the episode is over."""
    outcomes = [step()]
    while not any(outcomes[-1][2:4]):
        outcomes.append(step())
    return outcomes
