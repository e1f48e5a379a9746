"""Traffic twins: single-lane car-following simulated for thousands of roads at once.

They follow SUMO's integration and safety rules, so that a policy trained here can be driven there
(docs/traffic.md compares the two). `mbtl.engine.worlds.world.World` is what a learner asks of them.
"""
