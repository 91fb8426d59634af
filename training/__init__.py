"""Training, evaluation and export of policies; the import registers `dsl_assembly/PegInHole-v0` with Gymnasium.

The extra `training` installs Gymnasium. Without it, this package still imports; modules that need Gymnasium do not.
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
