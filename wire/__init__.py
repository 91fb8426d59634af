"""Vocabulary that service and simulator share: UR's RTDE and primary codecs, the simulated cell's records and keys,
poses, Zenoh sessions and the real-time request. It imports neither side.
"""
