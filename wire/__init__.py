"""What service and simulator both speak: UR's RTDE and primary codecs, the simulated cell's records and keys, poses,
Zenoh sessions and the real-time request. Imports neither side.
"""
