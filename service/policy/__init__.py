"""What runs a trained policy: its contract, observations built from the contract, the model, and the action's meaning.

The same code serves a cell (batch shape `()`) and batched training (`(n,)`).
"""
