"""Walking and running robots with gravity, friction and the body as context (cmdp-spec, 4.3, 4.4).

Each is a Gymnasium environment for one simulation, and a batch of many for the engine
(`mbtl.engine.worlds.hosted`); both take their physics from the same constants.
"""
