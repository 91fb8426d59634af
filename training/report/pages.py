"""Addresses of the documents that the generated pages link to, as seen from the folder `docs/`."""

CONDITIONS = "reference/conditions.md"
POLICY_CONTRACT = "reference/policy-contract.md"
RESULTS = "results.md"
