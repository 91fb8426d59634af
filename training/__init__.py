"""Training, evaluation and export of policies; the import registers `dsl_assembly/PegInHole-v0` with Gymnasium.

Gymnasium comes with the extra `training`. Modules that need it import it themselves.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is not None:
    import gymnasium

    from training.environment.design import MAX_STEPS

    gymnasium.register(
        "dsl_assembly/PegInHole-v0",
        entry_point="training.environment.peg_in_hole:PegInHoleEnv",
        vector_entry_point="training.environment.peg_in_hole:PegInHoleVectorEnv",
        max_episode_steps=MAX_STEPS,
    )
