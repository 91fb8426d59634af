import json
from pathlib import Path
from typing import Any

import pytest

from api.application import build_routes
from api.problems import STATUS_OF_REASON
from service.messages import RefusalReason

SNAPSHOT = Path(__file__).with_name("openapi.json")
UPDATE = f"dsl-assembly openapi > {SNAPSHOT.relative_to(Path(__file__).parents[2])}"


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return json.loads(json.dumps(build_routes().openapi()))


def operations(document: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [(f"{method} {path}", op) for path, item in document["paths"].items() for method, op in item.items()]


def test_the_document_is_the_committed_one(document: dict[str, Any]) -> None:
    assert document == json.loads(SNAPSHOT.read_text()), (
        f"the HTTP interface changed: run `{UPDATE}` and write the change into CHANGELOG.md"
    )


def test_every_operation_has_an_id_a_tag_and_a_description(document: dict[str, Any]) -> None:
    found = operations(document)
    assert len({operation["operationId"] for _, operation in found}) == len(found) >= 9
    for name, operation in found:
        assert operation["tags"], name
        assert operation["summary"], name
        assert operation["description"], name


def test_every_error_is_a_problem_with_an_example(document: dict[str, Any]) -> None:
    for name, operation in operations(document):
        for status, response in operation["responses"].items():
            if int(status) >= 400:
                content = response["content"]["application/problem+json"]
                assert content["example"]["status"] == int(status), (name, status)
                assert content["schema"]["$ref"].endswith("/ProblemDetails")
    assert "ProblemDetails" in document["components"]["schemas"]
    assert "HTTPValidationError" not in document["components"]["schemas"]


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    def references(node: Any) -> set[str]:
        if isinstance(node, dict):
            return {node["$ref"]} if "$ref" in node else set().union(*map(references, node.values()))
        return set().union(*map(references, node)) if isinstance(node, list) else set()

    for reference in references(document):
        assert reference.removeprefix("#/components/schemas/") in document["components"]["schemas"]


def test_every_body_has_an_example(document: dict[str, Any]) -> None:
    for name in ("StartBody", "ResetBody", "RunPage"):
        assert document["components"]["schemas"][name]["examples"]


def test_every_reason_of_the_control_process_has_a_status() -> None:
    assert set(STATUS_OF_REASON) == set(RefusalReason)
