"""Runs a trained policy: contract, observations built from the contract, model, and action map.

The same code serves a cell (batch shape `()`) and batched training (`(n,)`).
"""
