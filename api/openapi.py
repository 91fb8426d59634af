"""Prints the OpenAPI document: `python -m api.openapi > tests/api/openapi.json` after the interface has changed."""

import json
import sys

from api.application import build_routes

if __name__ == "__main__":
    json.dump(build_routes().openapi(), sys.stdout, indent=1)
    sys.stdout.write("\n")
