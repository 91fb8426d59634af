"""Learning: experiments, PPO, checkpoints, and the export of a trained policy."""
