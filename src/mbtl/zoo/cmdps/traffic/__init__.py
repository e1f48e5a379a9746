"""Traffic CMDPs on SUMO: signals, eco-driving and advisory autonomy (cmdp-spec, sections 5 to 7).

One class per family, a Gymnasium environment built from a context like the control tasks. What
differs from them:

- The matrix entry is not the RL return but a measure of traffic (mean speed, waiting time). It is
  in `info["score"]` of the step that ends an episode, larger being better.
- An episode is a simulation of its own: `reset` starts it, the last step or `close` ends it. Only
  one simulation per process is fast, see `simulation`.
- Where many cars decide, the environment is PettingZoo's (`team`); `slots` and `shared` let
  Stable-Baselines3 train one policy for all of them.

Nothing here is imported by the rest of `mbtl.problems` before an environment is made.
"""
