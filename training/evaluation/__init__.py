"""Evaluation: policies played on test seeds, in the environment or through the service, and their results as files."""
