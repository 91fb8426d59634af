"""Addresses of the documents that the generated pages link to, as seen from the folder `docs/`."""

CONDITIONS = "conditions.md"
POLICY_CONTRACT = "policy-contract.md"
RESULTS = "results.md"
EXPERIMENTS = "experiments.md"
