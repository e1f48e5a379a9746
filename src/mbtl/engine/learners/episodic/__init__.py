"""Learning from whole episodes, of worlds with any number of agents: TRPO, PPO and DQN."""
