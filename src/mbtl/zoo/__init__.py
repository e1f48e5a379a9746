"""The laboratory, a client of the tool and the engine.

    cmdps         the paper's 22 CMDPs and two more, in Gymnasium and SUMO
    worlds        the same simulators in jax, for whole batches
    benchmark     transfer matrices, replay, comparison of selectors
    small         two hundred small problems, to tell rules apart
    reproduction  the paper's tables and figures
    cli           the commands of all that

The tool knows it by `mbtl.zoo.provider` only.
"""
