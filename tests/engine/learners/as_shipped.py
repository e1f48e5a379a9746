"""For tests of equal bits: compile as for users; what `make test` compiles rounds otherwise."""

AS_SHIPPED = {"xla_backend_optimization_level": 3, "xla_cpu_use_fusion_emitters": True}
"""`compiler_options` of `jax.jit`; they go before XLA_FLAGS."""
